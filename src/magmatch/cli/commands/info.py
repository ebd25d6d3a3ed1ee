# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch info``: show what a file holds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map, read_result
from magmatch.cli.narration import put
from magmatch.cli.outputs import as_json
from magmatch.cli.registering import tell_result
from magmatch.number_text import told

EXAMPLES = (
    "magmatch info survey.csv --field-unit uT",
    "magmatch info room.map --json",
    "magmatch info drive.mcap",
    "magmatch info result.json",
)
# Units of the facts that `info` shows, by name.
UNITS = {
    "pose_sd": "m", "low": "m", "high": "m", "extent": "m", "path_length": "m", "median_step": "m",
    "median_magnitude": "uT", "smallest_magnitude": "uT", "largest_magnitude": "uT", "mean": "uT", "sd": "uT",
    "first": "s", "last": "s", "duration": "s", "rate": "Hz", "longest_gap": "s",
    "sensor_bias_spread": "uT", "lengthscale": "m", "spacing": "m", "signal_sd": "uT", "noise_sd": "uT",
    "spline": "uT", "divergence_free": "uT", "curl_free": "uT", "harmonic": "uT",
}  # fmt: skip


@command("info", EXAMPLES, surveys=(), reads="FILE")
def info(
    file: Annotated[
        Path, typer.Argument(help="Survey, log, saved map, trajectory or registration result.", metavar="FILE")
    ],
    layouts: Layouts,
    json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show what FILE holds.

    Shows counts, extent, units, frames, gaps and quality warnings.
    """
    from magmatch.data.read import kind_of

    kind = kind_of(file, layouts.of())
    if kind == "registration":
        result = read_result(file)
        put(as_json({"kind": "registration"} | result.to_dict()) if json else tell_result(result))
        return
    names = {"tum": "trajectory", "map": "map", "log": "log", "phone": "phone log"}
    facts = {"kind": names.get(kind, "survey"), "file": str(file)}
    of_kind = {"map": _of_map, "tum": _of_trajectory, "log": _of_log, "phone": _of_phone}
    facts |= of_kind.get(kind, _of_survey)(file, layouts)
    put(as_json(facts) if json else info_table(facts))


def _of_log(path: Path, layouts: Layouts) -> dict[str, Any]:
    """Topics of a recorder log, and the survey in it if there is one."""
    from magmatch.data.logs.read import list_topics

    topics, chosen = list_topics(path, layouts.of())
    return _with_survey({"topics": [topic.facts() for topic in topics], "chosen": chosen}, path, layouts)


def _of_phone(path: Path, layouts: Layouts) -> dict[str, Any]:
    """Sensors of a phone's log, and the survey that it gives with poses."""
    from magmatch.data.formats.phones.read import read_phone_log

    log = read_phone_log(path, recover=layouts.of().recover, with_points=True)
    return _with_survey({"app": log.app, "topics": log.facts()}, path, layouts)


def _with_survey(facts: dict[str, Any], path: Path, layouts: Layouts) -> dict[str, Any]:
    """Contents of a log, with its survey or the reason why there is none."""
    from magmatch.errors import MagmatchError

    try:
        return facts | _of_survey(path, layouts)
    except MagmatchError as error:
        return facts | {"no_survey": str(error)}


def _of_survey(path: Path, layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.describe import describe
    from magmatch.data.read import read_unchecked

    return describe(*read_unchecked(path, layouts.of()))


def _of_map(path: Path, _layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.describe import describe

    field_map = read_map(path)
    numbers = field_map.hyperparameters.as_dict()
    facts: dict[str, Any] = {"prior": field_map.config.prior}
    if field_map.config.comparison:
        facts["left_out_error"] = field_map.config.comparison
    if field_map.biases is not None:
        facts |= field_map.biases.facts(field_map.surveys)
    return facts | {"hyperparameters": numbers} | describe(field_map.survey)


def _of_trajectory(path: Path, layouts: Layouts) -> dict[str, Any]:
    from magmatch.data.formats.load_trajectory import load_trajectory

    layout = layouts.of()
    trajectory = load_trajectory(path, layout, layout.time_unit)
    times, p = trajectory.times, trajectory.positions
    return {
        "poses": len(times),
        "units": {"length": "m", "time": "s"},
        "low": p.min(axis=0).tolist(),
        "high": p.max(axis=0).tolist(),
        "time": {"first": float(times[0]), "last": float(times[-1]), "duration": float(times[-1] - times[0])},
    }


def info_table(facts: Mapping[str, Any]) -> str:
    """Format nested facts as aligned lines."""
    rows = list(_rows(facts))
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {text}" for name, text in rows)


def _rows(facts: Mapping[str, Any], above: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, value in facts.items():
        label = (above + name).replace("_", " ")
        if isinstance(value, Mapping):
            rows += _rows(value, f"{above}{name} ")
        elif name == "topics":
            rows += [("topic", _topic_text(topic)) for topic in value] or [("topics", "none")]
        elif name == "sensor_biases":
            rows += [
                (f"bias of {one['name']}", f"{_text(one['bias'], 'uT')} (sd {_text(one['bias_sd'], 'uT')})")
                for one in value
            ]
        elif name == "warnings":
            rows += [("warning", str(w)) for w in value] or [("warnings", "none")]
        else:
            # Seconds since 1970 have ten digits before the point.
            is_moment = above.endswith("time ") and name in {"first", "last"} and value is not None
            rows.append((label, f"{value:.3f} s" if is_moment else _text(value, UNITS.get(name, ""))))
    return rows


def _topic_text(topic: Mapping[str, Any]) -> str:
    """One line of a log's contents."""
    text = f"{topic['name']}  {topic['type']}  {topic['count']} messages"
    if topic["rate"] is not None:
        text += f", {topic['rate']:.4g} Hz, {topic['span'][1] - topic['span'][0]:.6g} s"
    return text


def _text(value: Any, unit: str) -> str:
    match value:
        case None:
            return "none"
        case bool():
            return "yes" if value else "no"
        case list():
            return ", ".join(_text(v, "") if unit != "uT" else f"{1e6 * v:.4g}" for v in value) + f" {unit}".rstrip()
        case float():
            # To a thousandth, however large: coordinates far from their origin.
            return f"{told(1e6 * value if unit == 'uT' else value, 6, 1e-3)} {unit}".rstrip()
    return f"{value} {unit}".rstrip()
