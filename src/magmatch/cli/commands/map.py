# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch map``: infer the field of a place and save it."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map, read_samples, require_own_poses
from magmatch.cli.narration import say
from magmatch.cli.option_values import numbers, processes, refuse
from magmatch.cli.outputs import check_outputs
from magmatch.cli.settings import merged
from magmatch.data.units import field_text
from magmatch.field.config import FieldConfig, PriorName

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.runner import Workers

log = logging.getLogger(__name__)

# T: rounding.
SAME_FIELD = 1e-12

EXAMPLES = (
    "magmatch map room.csv --out room.map",
    "magmatch map drive.mcap --out hall.map",
    "magmatch map monday.csv tuesday.csv --field-unit uT --out room.map",
    "magmatch map room.csv --out room.map --report room.html",
    "magmatch map room.csv --prior divergence_free --domain 0,0,0,5,4,2 --out room.map",
    "magmatch map building.map friday.csv --out building.map",
    "magmatch map building.csv --jobs 4 --out building.map",
)


@command("map", EXAMPLES, surveys=(), reads="every SURVEY")
def build(
    layouts: Layouts,
    surveys: list[Path] = Argument(
        ...,
        help="Surveys (or saved maps) in one frame; several are mapped together. If the first is a saved map and "
        "no setting is given, the others are added to it, and only the part that they touch is fitted again.",
        metavar="SURVEY",
    ),
    out: Path = Option(..., help="Write the map here."),
    report: Path | None = Option(None, help="Write an HTML report on the map here."),
    prior: PriorName | None = Option(
        None, help="Prior of the field; auto (default) chooses the one that predicts held-out data best."
    ),
    domain: str | None = Option(
        None, help="Box to map, X0,Y0,Z0,X1,Y1,Z1 in metres; by default to about a lengthscale from the samples."
    ),
    config: Path | None = Option(None, help="YAML file of field settings (lengthscale, noise_sd, ...)."),
    jobs: int = Option(1, min=1, help="Processes that fit the tiles of a large map."),
    scheduler: str | None = Option(None, help="Dask scheduler whose workers fit the tiles instead, tcp://HOST:PORT."),
) -> None:
    """Build and save a field map, or add surveys to one."""
    from magmatch.data.formats.sniff import sniff
    from magmatch.field.build import build_map

    require_own_poses(surveys, layouts, "SURVEY")
    is_addition = (
        prior is None and domain is None and config is None and sniff(surveys[0]) == "map" and len(surveys) > 1
    )
    # A map that grows may take its own place: it is replaced in one step, once the new one is whole.
    check_outputs((out,), inputs=[*surveys[1 if is_addition else 0 :], config], page=report)
    if is_addition:
        with processes(jobs, scheduler) as run:
            grown = extend(surveys[0], surveys[1:], layouts, out, run)
        draw(report, grown, (), layouts.again("map", surveys, "--out", out))
        return
    settings = merged(FieldConfig(), config, "field")
    stated: dict[str, Any] = {} if prior is None else {"prior": prior}
    if domain is not None:
        stated["domain"] = parse_domain(domain)
    settings = FieldConfig.model_validate(settings.model_dump() | stated)
    samples = [read_samples(path, layouts) for path in surveys]
    refuse_repeats(surveys, samples)
    with processes(jobs, scheduler) as run:
        field_map = build_map(samples, settings, run)
    field_map.save(out)
    h, errors = field_map.hyperparameters, field_map.config.comparison
    if errors:
        told = ", ".join(f"{name} {field_text(error)}" for name, error in sorted(errors.items(), key=lambda e: e[1]))
        say(f"Chose prior {field_map.config.prior}; typical error on held-out data: {told}")
    words = "" if field_map.biases is None else f"{field_map.biases.in_words}; 'magmatch info' lists them\n"
    say(
        f"Mapped {len(field_map.survey)} samples: lengthscale {h.lengthscale:.3g} m, field varies by "
        f"{field_text(h.signal_sd)}, noise {field_text(h.noise_sd)}\n{words}Wrote the map to {out}"
    )
    if field_map.biases is not None and len(field_map.surveys) == len(samples):
        samples = list(field_map.biases.without(samples))
    _warn_of_sensors(samples, field_map)
    draw(report, field_map, samples, layouts.again("map", surveys, "--config", "settings.yaml", "--out", out))


def _warn_of_sensors(surveys: "Sequence[Survey]", field_map: "FieldMap") -> None:
    """Warn if part of the readings turns with the sensor, since a map of them is not the field of the place."""
    from magmatch.data.diagnoses import diagnose
    from magmatch.preparation.sensor_trace import MIN_EVIDENCE, offset_evidence

    for survey in surveys:
        # Vectors in a wrong frame were already reported, with a remedy.
        is_wrong = any(one.is_of_frames for one in diagnose(survey))
        if not is_wrong and offset_evidence(survey, field_map.hyperparameters) >= MIN_EVIDENCE:
            log.warning("%s: its readings turn with the sensor; 'magmatch prepare' calibrates it", survey.name)


def draw(report: Path | None, field_map: "FieldMap", read: "Sequence[Survey]", command: str) -> None:
    """Write the map's report, if one was requested."""
    if report is None:
        return
    from magmatch.viz.pages.map_page import write_map_report

    write_map_report(report, field_map, read, command)
    say(f"Wrote the report to {report}")


def extend(path: Path, more: Sequence[Path], layouts: Layouts, out: Path, run: "Workers | None") -> "FieldMap":
    """Add surveys to a saved map."""
    old, surveys = read_map(path), [read_samples(one, layouts) for one in more]
    refuse_repeats([*[path] * len(old.surveys), *more], [*old.surveys, *surveys])
    new = old.with_surveys(*surveys, run=run)
    new.save(out)
    say(f"Added {len(new.survey) - len(old.survey)} samples to {len(old.survey)}\nWrote the map to {out}")
    return new


def refuse_repeats(paths: Sequence[Path], surveys: "Sequence[Survey]") -> None:
    """Refuse samples that are given twice: the map would be surer than it can be."""
    from magmatch.errors import DataFormatError

    known: list[tuple[Path, Survey, dict[bytes, int]]] = []
    for path, survey in zip(paths, surveys, strict=True):
        places = [p.tobytes() for p in survey.positions]
        for earlier, other, rows in known:
            if hold_the_same(survey, places, other, rows):
                raise DataFormatError(path, f"holds the same samples as {earlier}, expected each only once")
        known.append((path, survey, {place: k for k, place in enumerate(places)}))


def hold_the_same(one: "Survey", places: Sequence[bytes], other: "Survey", rows: Mapping[bytes, int]) -> bool:
    """Whether most samples of a survey stand in another; a map keeps them without outliers and without a bias.

    ``places`` are its positions, ``rows`` where the other has each.
    """
    import numpy as np

    pairs = [(k, rows[place]) for k, place in enumerate(places) if place in rows]
    if 2 * len(pairs) <= len(one):
        return False
    here, there = np.array(pairs).T
    # A bias that turns with the sensor has one size; no two measurements differ by one.
    return bool(np.ptp(np.linalg.norm(one.field[here] - other.field[there], axis=1)) <= SAME_FIELD)


def parse_domain(text: str) -> tuple[float, ...]:
    """Six numbers, the lower corner below the upper one."""
    expected = "X0,Y0,Z0,X1,Y1,Z1 in metres with X0 < X1, Y0 < Y1, Z0 < Z1"
    corners = numbers("--domain", text, 6, expected)
    if not all(-1e9 < low < high < 1e9 for low, high in zip(corners[:3], corners[3:], strict=True)):
        refuse("--domain", expected, text)
    return tuple(corners)
