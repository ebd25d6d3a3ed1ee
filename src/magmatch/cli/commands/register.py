# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch register``: find the transform between two surveys."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from typer import Argument, Option

from magmatch.cli.command import JSON, SEED, Layouts, command
from magmatch.cli.inputs import read_survey_or_map
from magmatch.cli.outputs import answer, check_folder, check_outputs
from magmatch.cli.registering import tell_result, with_help, with_wait
from magmatch.cli.settings import Preset, Sensor, registration_config, with_limits, with_prior

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.field.map import FieldMap
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.result import RegistrationResult

EXAMPLES = (
    "magmatch register base.csv target.csv",
    "magmatch register base.csv target.csv --out result.json --report result.html",
    "magmatch register base.csv target.csv --field-unit uT --target-length-unit mm",
    "magmatch register monday.bag tuesday.mcap --target-pose-topic /slam/pose",
    "magmatch register room.map target.csv --preset paper --json > result.json",
    "magmatch register base.csv target.csv --preset paper --figures figures",
    "magmatch register hall.map robot.csv --gravity-aligned --prior-pose 3,1.5,0,0,0,0,1 --prior-pose-sd 2,30",
    "magmatch register floor.map robot.csv --planar",
    "magmatch register base.csv target.csv --min-probability 0.999 --max-sd 0.05,1",
    "magmatch register buildings/ walk.csv   # which of the maps in this folder, and where in it",
)


@command("register", EXAMPLES, surveys=("base", "target"), reads="BASE and TARGET")
def register(
    layouts: Layouts,
    base: Path = Argument(
        ..., help="Survey, saved map or folder of saved maps that defines the frame.", metavar="BASE"
    ),
    target: Path = Argument(..., help="Survey or saved map to bring into that frame.", metavar="TARGET"),
    out: Path | None = Option(None, help="Write the result here (JSON)."),
    report: Path | None = Option(None, help="Write an HTML report here."),
    figures: Path | None = Option(None, help="Write figures into this folder, each as PNG and SVG.", metavar="DIR"),
    preset: Preset = Option(
        "default", help="Settings to start from; paper is as published, paper-literal to the letter, and slow."
    ),
    sensor: Sensor = Option("auto", help="Differences between the magnetometers to estimate."),
    prior_pose: str | None = Option(None, help="Rough T_base_target: x,y,z,qx,qy,qz,qw (m), or a result file."),
    prior_pose_sd: str | None = Option(
        None, help="Standard deviations of that pose at the target: metres,degrees.  [default: 1,9.7]"
    ),
    gravity_aligned: bool = Option(
        False, "--gravity-aligned", help="z points up in both surveys: search position and heading only."
    ),
    planar: bool = Option(
        False, "--planar", help="As --gravity-aligned, and both frames agree in height: search x, y and heading only."
    ),
    gravity_sd: float | None = Option(
        None, help="Accuracy of the vertical, degrees.  [default: 0.57]", min=0.001, max=45
    ),
    min_probability: float | None = Option(None, help="Least probability of an accepted pose.  [default: 0.99]"),
    max_sd: str | None = Option(
        None,
        help="Largest standard deviation of an accepted pose: metres,degrees.  "
        "[default: 0.3 correlation lengths of the field, 10 degrees]",
    ),
    config: Path | None = Option(None, help="YAML file of settings, or an earlier result: overrides the preset's."),
    seed: int = SEED,
    keep_index: bool = Option(True, help="Keep what was prepared of a saved map beside it, for later targets."),
    json: bool = JSON,
) -> int:
    """Find the transform from TARGET to BASE.

    The answer is a rigid transform that takes TARGET's coordinates to BASE's, or the reason why there is none. If
    BASE is a folder of maps, the result also names the map that contains TARGET.

    Each survey is taken as rigid. Odometry that drifts is corrected by 'magmatch slam', which also ties logs.

    Exit code 0: accepted; 3: not accepted, with the reason.
    """
    with_help()
    settings = registration_config(preset, config, sensor)
    settings = with_prior(
        settings,
        is_aligned=gravity_aligned,
        is_planar=planar,
        gravity_sd=gravity_sd,
        pose=prior_pose,
        pose_sd=prior_pose_sd,
    )
    settings = with_limits(settings, min_probability, max_sd)
    check_outputs((out,), inputs=(base, target, config), page=report)
    if figures is not None:
        from magmatch.viz.images import require_images

        check_folder(figures)
        require_images()
    loaded = perf_counter()
    read = read_survey_or_map(target, layouts, "target")
    base_map, mapped, result = _register(base, read, layouts, settings, seed, keep_index)
    result = with_wait(result, loaded)
    if out is not None:
        result.save(out)
    if report is not None or figures is not None:
        from magmatch.registration.maps import as_map
        from magmatch.viz.pages.registration_page import write_report

        # If no map of a folder fits, there is nothing to draw; the report then has text only.
        target_map = None if base_map is None else as_map(mapped, settings.field)
        published = settings.keypoints if settings.search == "keypoints" else None
        if report is not None:
            again = layouts.again("register", [base, target], "--config", "settings.yaml", "--seed", seed)
            write_report(report, base_map, target_map, result, again, published)
        if figures is not None and base_map is not None and target_map is not None:
            from magmatch.viz.images import registration_figures, write_images

            write_images(figures, registration_figures(base_map, target_map, result, published))
    words = tell_result(result, out, report, figures if base_map is not None else None)
    return answer(result, words, is_good=result.is_accepted, json=json)


def _register(
    base: Path,
    target: "Survey | FieldMap",
    layouts: Layouts,
    settings: "RegistrationConfig",
    seed: int,
    keep: bool,
) -> "tuple[FieldMap | None, Survey | FieldMap, RegistrationResult]":
    """Register against a file or a folder; gives the maps of the answer (no base if no map of a folder fits)."""
    from magmatch.registration.index.atlas import is_atlas
    from magmatch.registration.maps import map_of
    from magmatch.registration.register import register_keeping_maps

    read: Path | Survey | FieldMap = base
    if not is_atlas(base):
        read = read_survey_or_map(base, layouts, "base")
        # A map that was not read from a file keeps nothing.
        read = read if keep else replace(read)
    used, mapped, result = register_keeping_maps(read, target, settings, seed=seed)
    return None if used is None else map_of(used), mapped, result
