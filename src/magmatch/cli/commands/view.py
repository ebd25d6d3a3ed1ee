# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch view``: a picture of a survey, a map or a registration, or a recording of it."""

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError
from typer import Argument, Option

from magmatch.cli.command import RERUN, Layouts, command, flag_of
from magmatch.cli.inputs import read_result, read_survey_or_map
from magmatch.cli.narration import put
from magmatch.cli.option_values import refuse
from magmatch.cli.outputs import check_outputs, free_name
from magmatch.errors import ConfigurationError

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.result import RegistrationResult

EXAMPLES = (
    "magmatch view survey.csv --field-unit uT --out survey.html",
    "magmatch view room.map --out room.html",
    "magmatch view result.json base.csv target.csv --out result.html",
    "magmatch view room.map walk.csv --rerun room.rrd",
)


@command("view", EXAMPLES, surveys=("base", "target"), reads="every FILE")
def view(
    layouts: Layouts,
    files: list[Path] = Argument(
        ..., help="Surveys, saved maps, or a registration result with its base and target.", metavar="FILE"
    ),
    out: Path | None = Option(
        None, help="Write here (HTML); by default in this folder, named after the first file, where no file is yet."
    ),
    rerun: Path | None = RERUN,
) -> None:
    """Draw surveys, maps or a registration.

    Writes one HTML page that works offline, and prints its path on stdout. With --rerun, writes a recording instead;
    with --out as well, both. Surveys given with a result are mapped with the result's settings.
    """
    from magmatch.data.formats.sniff import sniff

    goal = out or (None if rerun else free_name(files[0].stem, ".html"))
    check_outputs((), inputs=files, page=goal, recording=rerun)
    results = [path for path in files if sniff(path) == "registration"]
    others = [path for path in files if path not in results]
    if len(results) > 1 or (results and len(others) not in {0, 2}):
        msg = (
            "expected surveys and maps, or one registration result, alone or with its base and target; "
            f"found {len(results)} results and {len(others)} surveys or maps"
        )
        raise ConfigurationError(msg)
    own = next((place for place in layouts.given if place[0]), None)
    if own and not (results and others):
        refuse(flag_of(*own), "a registration result with its base and target", "none")
    sides = ("base", "target") if results else ("",) * len(others)
    drawn = [read_survey_or_map(path, layouts, side) for path, side in zip(others, sides, strict=False)]
    if rerun and not drawn:
        msg = "a registration result alone has nothing in space; give its base and target too"
        raise ConfigurationError(msg)
    result = read_result(results[0]) if results else None
    settings = None if result is None else _settings_of(result)
    if result is not None:
        drawn = [_mapped(item, result, settings, side) for item, side in zip(drawn, ("base", "target"), strict=False)]
    if goal is not None:
        from magmatch.viz.pages.registration_page import write_report
        from magmatch.viz.view import write_view

        if result is None:
            write_view(goal, drawn)
        else:
            base, target = drawn or (None, None)
            published = settings.keypoints if settings is not None and settings.search == "keypoints" else None
            write_report(goal, base, target, result, published=published)
        put(str(goal))
    if rerun is not None:
        from magmatch.viz.rerun_recording import scene_of, write_rerun

        write_rerun(rerun, scene_of(drawn, result))
        put(str(rerun))


def _settings_of(result: "RegistrationResult") -> "RegistrationConfig | None":
    """Settings of a result; none where they are of another version."""
    from magmatch.registration.config import RegistrationConfig

    try:
        return RegistrationConfig.model_validate(result.config)
    except ValidationError:
        return None


def _mapped(
    item: "Survey | FieldMap", result: "RegistrationResult", settings: "RegistrationConfig | None", side: str
) -> "Survey | FieldMap":
    """A survey's map as the registration made it, for residuals and cuts; the survey if it cannot be mapped."""
    from magmatch.errors import SurveyError
    from magmatch.field.map import FieldMap
    from magmatch.registration.maps import as_map
    from magmatch.registration.sensor_calibration import without_sensor_errors

    as_given = item.measured if isinstance(item, FieldMap) else item
    used = without_sensor_errors(as_given, result.sensor, side)
    try:
        return item if settings is None else as_map(item if used is as_given else used, settings.field)
    except SurveyError:
        return item
