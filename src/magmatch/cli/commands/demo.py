# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch demo``: a registration of small packaged surveys, compared with the truth."""

from importlib.resources import as_file, files
from json import loads
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from typer import Option

from magmatch.cli.command import JSON, command
from magmatch.cli.narration import say
from magmatch.cli.outputs import answer, check_folder
from magmatch.cli.registering import tell_result, with_help, with_wait
from magmatch.errors import MissingExtraError

if TYPE_CHECKING:
    from magmatch.data.survey import Survey
    from magmatch.registration.result import RegistrationResult

EXAMPLES = ("magmatch demo", "magmatch demo --out demo-output", "magmatch demo --json")


@command("demo", EXAMPLES)
def demo(
    out: Path = Option(Path("magmatch-demo"), help="Folder for the result and its report."),
    seed: int = Option(0, help="Seed of the registration.", min=0),
    json: bool = JSON,
) -> int:
    """Register packaged surveys of an office room.

    Both are simulated, so the answer is compared with the truth.
    """
    check_folder(out)
    from magmatch.data.read import read_survey
    from magmatch.registration.config import PRESETS
    from magmatch.registration.maps import as_map, map_of
    from magmatch.registration.register import register_keeping_maps

    with_help()
    loaded = perf_counter()
    with as_file(files("magmatch.data") / "samples" / "office") as folder:
        base, target = read_survey(folder / "base.csv"), read_survey(folder / "target.csv")
        truth = loads((folder / "truth.json").read_text())
    settings = PRESETS["default"]
    used, mapped, result = register_keeping_maps(base, target, settings, seed=seed)
    result = with_wait(result, loaded)
    out.mkdir(exist_ok=True)
    result.save(out / "result.json")
    report: Path | None = out / "report.html"
    try:
        from magmatch.viz.pages.registration_page import write_report

        target_map, command = as_map(mapped, settings.field), f"magmatch demo --seed {seed}"
        write_report(out / "report.html", map_of(used), target_map, result, command)  # type: ignore[arg-type]
    except MissingExtraError as error:
        report = None
        say(f"No report: {error}")
    room = f"Office room, simulated: base {len(base)} samples, target {len(target)} samples in another frame"
    words = "\n".join([room, tell_result(result, out / "result.json", report), _compare(result, truth, target)])
    return answer(result, words, is_good=result.is_accepted, json=json)


def _compare(result: "RegistrationResult", truth: dict[str, Any], target: "Survey") -> str:
    """Error against the truth, in words."""
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from magmatch.geometry import transform_error

    if result.T_base_target is None:
        return "There is no transform to compare with the truth"
    T_true = RigidTransform.from_matrix(np.array(truth["T_base_target"], dtype=np.float64))
    translation, rotation = transform_error(result.T_base_target, T_true, target.centroid)
    return f"Error against the truth: {1e3 * translation:.1f} mm, {np.rad2deg(rotation):.2f} deg"
