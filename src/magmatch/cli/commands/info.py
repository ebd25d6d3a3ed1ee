# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch info``: show what a file holds."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map, read_result
from magmatch.cli.narration import put
from magmatch.cli.outputs import as_json
from magmatch.cli.registering import tell_result
from magmatch.errors import MagmatchError
from magmatch.number_text import told

if TYPE_CHECKING:
    from magmatch.data.formats.format import SurveyFormat

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
    layouts: Layouts,
    file: Path = Argument(..., help="Survey, log, saved map, trajectory or registration result.", metavar="FILE"),
    json: bool = Option(False, "--json", help="Print as JSON."),
) -> None:
    """Show what FILE holds.

    Shows counts, extent, units, frames, gaps and quality warnings.
    """
    from magmatch.data.read import kind_of

    layout = layouts.of()
    kind = kind_of(file, layout)
    if kind == "registration":
        result = read_result(file)
        put(as_json({"kind": "registration"} | result.to_dict()) if json else tell_result(result))
        return
    name, facts_of = KINDS.get(kind, ("survey", _of_survey))
    facts = {"kind": name, "file": str(file)} | facts_of(file, layout)
    put(as_json(facts) if json else info_table(facts))


def _of_log(path: Path, layout: "SurveyFormat") -> dict[str, Any]:
    """Topics of a recorder log, and the survey in it if there is one."""
    from magmatch.data.logs.read import list_topics

    topics, chosen = list_topics(path, layout)
    return {"topics": [topic.facts() for topic in topics], "chosen": chosen} | _survey_if_any(path, layout)


def _of_phone(path: Path, layout: "SurveyFormat") -> dict[str, Any]:
    """Sensors of a phone's log, and the survey that it gives with poses."""
    from magmatch.data.formats.phones.read import read_phone_log

    log = read_phone_log(path, recover=layout.recover, with_points=True)
    return {"app": log.app, "topics": log.facts()} | _survey_if_any(path, layout)


def _survey_if_any(path: Path, layout: "SurveyFormat") -> dict[str, Any]:
    """The survey in a log, or the reason why there is none."""
    try:
        return _of_survey(path, layout)
    except MagmatchError as error:
        return {"no_survey": str(error)}


def _of_survey(path: Path, layout: "SurveyFormat") -> dict[str, Any]:
    from magmatch.data.describe import describe
    from magmatch.data.read import read_unchecked

    return describe(*read_unchecked(path, layout))


def _of_map(path: Path, _: "SurveyFormat") -> dict[str, Any]:
    from magmatch.data.describe import describe

    field_map = read_map(path)
    numbers = field_map.hyperparameters.as_dict()
    facts: dict[str, Any] = {"prior": field_map.config.prior}
    if field_map.config.comparison:
        facts["left_out_error"] = field_map.config.comparison
    if field_map.biases is not None:
        facts |= field_map.biases.facts(field_map.surveys)
    return facts | {"hyperparameters": numbers} | describe(field_map.survey, parts=field_map.surveys)


def _of_trajectory(path: Path, layout: "SurveyFormat") -> dict[str, Any]:
    from magmatch.data.formats.load_trajectory import load_trajectory

    trajectory = load_trajectory(path, layout, layout.time_unit)
    times, p = trajectory.times, trajectory.positions
    return {
        "poses": len(times),
        "units": {"length": "m", "time": "s"},
        "low": p.min(axis=0).tolist(),
        "high": p.max(axis=0).tolist(),
        "time": {"first": float(times[0]), "last": float(times[-1]), "duration": float(times[-1] - times[0])},
    }


# What is said of each kind of file; all others are surveys.
KINDS = {
    "map": ("map", _of_map),
    "tum": ("trajectory", _of_trajectory),
    "log": ("log", _of_log),
    "phone": ("phone log", _of_phone),
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
        elif name in LISTS:
            rows += [LISTS[name](one) for one in value] or [(name, "none")]
        else:
            # Seconds since 1970 have ten digits before the point.
            is_moment = above.endswith("time ") and name in {"first", "last"} and value is not None
            rows.append((label, f"{value:.3f} s" if is_moment else _text(value, UNITS.get(name, ""))))
    return rows


def _topic(topic: Mapping[str, Any]) -> tuple[str, str]:
    """One line of a log's contents."""
    text = f"{topic['name']}  {topic['type']}  {topic['count']} messages"
    if topic["rate"] is not None:
        text += f", {topic['rate']:.4g} Hz, {topic['span'][1] - topic['span'][0]:.6g} s"
    return "topic", text


def _bias(one: Mapping[str, Any]) -> tuple[str, str]:
    return f"bias of {one['name']}", f"{_text(one['bias'], 'uT')} (sd {_text(one['bias_sd'], 'uT')})"


# Facts of which each item has a line of its own.
LISTS: dict[str, Callable[[Any], tuple[str, str]]] = {
    "topics": _topic,
    "sensor_biases": _bias,
    "warnings": lambda words: ("warning", str(words)),
}


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
