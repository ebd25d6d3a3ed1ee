# SPDX-License-Identifier: BSD-3-Clause
"""`PreparationReport`: what was done to a log, step by step, with figures before and after."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from magmatch._version import __version__
from magmatch.data.document import read_document, write_document
from magmatch.errors import DataFormatError
from magmatch.preparation.sensor_model import SensorModel

SCHEMA = "magmatch.preparation/1"
MAX_BYTES = 16 << 20
# off: not checked. unchanged: checked, nothing to do. applied: the survey was changed. flagged: found, not changed.
# unknown: not determined by the data.
Outcome = Literal["off", "unchanged", "applied", "flagged", "unknown"]


@dataclass(frozen=True, eq=False, slots=True)
class StepReport:
    """What one step did.

    Attributes
    ----------
    step : str
        Its name.
    outcome : str
        One of `Outcome`.
    words : str
        What was found, as text.
    before, after : float, optional
        The figure that the step is about, without and with it.
    unit : str
        Of that figure.
    figures : dict
        Numbers for programs, SI; ready for JSON.
    """

    step: str
    outcome: Outcome
    words: str
    before: float | None = None
    after: float | None = None
    unit: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class PreparationReport:
    """What was done to a log.

    Attributes
    ----------
    name : str
        The log.
    n_samples : (int, int)
        Before and after.
    steps : tuple of StepReport
        In the order they were done.
    config : dict
        The resolved configuration.
    sensor : SensorModel
        The correction as a whole, with a known one that was made first: what another log of this sensor can begin
        from.
    inputs : tuple of dict
        Name and SHA-256 of the files, where known.
    version : str
        Of the package.
    """

    name: str
    n_samples: tuple[int, int]
    steps: tuple[StepReport, ...]
    config: Mapping[str, Any]
    sensor: SensorModel = field(default_factory=SensorModel)
    inputs: tuple[Mapping[str, str], ...] = ()
    version: str = __version__

    def __getitem__(self, step: str) -> StepReport:
        """Report of one step by its name."""
        return next(report for report in self.steps if report.step == step)

    def table(self) -> str:
        """Lines for people: what each step did, before and after."""
        rows = [(s.step, s.outcome, _change(s), s.words) for s in self.steps if s.outcome != "off"]
        widths = [max(len(row[k]) for row in rows) if rows else 0 for k in range(3)]
        lines = ["  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[3]]) for row in rows]
        off = [s.step for s in self.steps if s.outcome == "off"]
        return "\n".join([*lines, *([f"off: {', '.join(off)}"] if off else [])])

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        steps = [{name: getattr(s, name) for name in StepReport.__dataclass_fields__} for s in self.steps]
        return {
            "schema": SCHEMA,
            "name": self.name,
            "n_samples": list(self.n_samples),
            "steps": steps,
            "config": dict(self.config),
            "sensor": self.sensor.as_dict(),
            "inputs": [dict(entry) for entry in self.inputs],
            "version": self.version,
        }

    def save(self, path: str | Path) -> None:
        """Write the report as JSON with a checksum, whole or not at all."""
        write_document(path, self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> "PreparationReport":
        """Read a report; one that was changed after writing is refused."""
        content = read_document(path, SCHEMA, "report of 'magmatch prepare'", MAX_BYTES)
        try:
            return cls(
                content["name"],
                (int(content["n_samples"][0]), int(content["n_samples"][1])),
                tuple(StepReport(**step) for step in content["steps"]),
                content["config"],
                SensorModel.from_dict(content["sensor"]),
                tuple(content["inputs"]),
                content["version"],
            )
        except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
            words = f"missing {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:150]
            raise DataFormatError(path, f"is not a report of 'magmatch prepare' ({SCHEMA}): {words}") from None


def _change(step: StepReport) -> str:
    """Figures before and after, in three digits."""
    if step.before is None:
        return ""
    before, after = (
        None if value is None else f"{value:.0f}" if step.unit == "samples" else f"{value:.3g}"
        for value in (step.before, step.after)
    )
    return f"{before}{'' if after is None else f' -> {after}'} {step.unit}".rstrip()
