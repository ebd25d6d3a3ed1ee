# SPDX-License-Identifier: BSD-3-Clause
"""`PreparationReport`: what was done to a log, step by step, with figures before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import PlainValidator

from magmatch._version import __version__
from magmatch.brief import brief
from magmatch.data.document import TypedDocument
from magmatch.data.fingerprint import hash_survey
from magmatch.data.survey import Survey
from magmatch.preparation.config import PreparationConfig
from magmatch.preparation.sensor_model import SensorCorrection

# off: not checked. unchanged: checked, nothing to do. applied: the survey was changed. flagged: found, not changed.
# unknown: not determined by the data.
Outcome = Literal["off", "unchanged", "applied", "flagged", "unknown"]


@dataclass(frozen=True, eq=False, slots=True)
class StepReport:
    """The result of one step."""

    step: str  # its name
    outcome: Outcome  # one of `Outcome`
    words: str  # what was found, as text
    before: float | None = None  # the figure that the step is about, without and with it
    after: float | None = None
    unit: str = ""  # of that figure
    figures: Mapping[str, Any] = field(default_factory=dict)  # numbers for programs, SI; ready for JSON


@dataclass(frozen=True, eq=False, slots=True)
class PreparationReport(TypedDocument):
    """The account of what was done to a log."""

    SCHEMA = "magmatch.preparation/1"
    KIND = "report of 'magmatch prepare'"
    MAX_BYTES = 16 << 20

    name: str  # the log
    n_samples: tuple[int, int]  # (int, int): before and after
    steps: tuple[StepReport, ...]  # in the order they were done
    config: Mapping[str, Any]  # the resolved configuration
    # The correction as a whole, with a known one that was made first: what another log of this sensor can begin from
    sensor: Annotated[SensorCorrection, PlainValidator(SensorCorrection.from_dict)]
    inputs: tuple[Mapping[str, str], ...]  # name and SHA-256 of the files, where known
    version: str  # of the package

    __repr__ = brief

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
        """The account, ready for JSON; its sensor is what holds for any log of it."""
        return TypedDocument.to_dict(self) | {"sensor": self.sensor.as_dict()}


def report_on(
    survey: Survey, left: Survey, steps: Sequence[StepReport], sensor: SensorCorrection, config: PreparationConfig
) -> PreparationReport:
    """Account for what was done to a survey, of which another is left."""
    n_samples, settings = (len(survey), len(left)), config.model_dump(mode="json")
    inputs = ({"name": survey.name, "sha256": hash_survey(survey)},)
    return PreparationReport(survey.name, n_samples, tuple(steps), settings, sensor, inputs, __version__)


def _change(step: StepReport) -> str:
    """Figures before and after: in three digits, or in as many as show what was applied."""
    if step.before is None:
        return ""
    if step.after is None:
        return f"{_figure(step.before, step.unit)} {step.unit}".rstrip()
    for digits in range(3, 7):
        before, after = (_figure(value, step.unit, digits) for value in (step.before, step.after))
        if before != after:
            return f"{before} -> {after} {step.unit}".rstrip()
    if step.outcome == "applied":
        return f"{_figure(step.after, step.unit)} {step.unit}, as before"
    return f"{_figure(step.before, step.unit)} -> {_figure(step.after, step.unit)} {step.unit}".rstrip()


def _figure(value: float, unit: str, digits: int = 3) -> str:
    return f"{value:.0f}" if unit == "samples" else f"{value:.{digits}g}"
