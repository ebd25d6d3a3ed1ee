# SPDX-License-Identifier: BSD-3-Clause
"""The named experiments: the published ones as equivalents, refusals, harder conditions, recordings, maps."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.held_out_field import PREDICTORS, HeldOut, RecordedField, SimulatedField
from magmatch_evaluation.survey_pairs import (
    CeaArea,
    CeaElsewhere,
    Halves,
    Interleaved,
    OnePlace,
    Simulated,
    SurveyPair,
    TurnedPairs,
    TwoRecordings,
)

ALL_METHODS = ("default", "paper", "sift", "sift-best", "kiss", "gicp", "refine-rough", "refine-identity")
MAIN_METHODS = ("default", "paper", "sift")
REAL_METHODS = ("default", "paper", "sift", "gicp")
# Group of the experiments that ask for maps against held-out data.
MAPPING = "mapping"


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far an answer may be off and still be right: m at the centroid of the target's samples, and degrees."""

    distance: float = 0.10
    angle_deg: float = 5.0


@dataclass(frozen=True, slots=True)
class Experiment:
    """One row of a table, or one point of a curve."""

    name: str  # unique, as typed on the command line
    title: str  # what is asked, in a few words
    group: str  # table or curve it belongs to
    # ``make(seed, recordings)``; its ``repr`` says all that what it makes depends on besides those
    make: Callable[[int, Path | None], SurveyPair | HeldOut]
    n_seeds: int  # trials of the full run
    methods: tuple[str, ...]  # names of the methods that are asked
    tolerance: Tolerance = field(default_factory=Tolerance)
    value: float | None = None  # where it is one point of a curve: its place on the axis, in the unit of the group
    dataset: str | None = None  # public recording that it needs
    floor: str = ""  # accuracy of the data themselves, in words


WALK = Tolerance(0.25, 5.0)


# The simulation as printed: noise of 0.01 T. No strength is printed; components within 0.01 T are described.
AS_PRINTED = SimulationConfig(noise_sd=0.01, anomaly_sd=0.01, n_samples=1000)


def _published() -> list[Experiment]:
    """Equivalents of the published experiments, whose data are not public; `notes.PRINTED` says what differs."""

    def one(
        name: str, title: str, make: Any = None, n: int = 20, methods: tuple[str, ...] = MAIN_METHODS
    ) -> Experiment:
        tolerance = WALK if name.startswith("corridor") else Tolerance()
        return Experiment(name, title, "published", make or Simulated(name), n, methods, tolerance)

    def room(kind: str, title: str, make: Any, n: int) -> list[Experiment]:
        return [
            one(f"{kind}-z30", f"{title}, turned by 30 deg about z", TurnedPairs(make, "z", 30.0), n),
            one(f"{kind}-x30", f"{title}, turned by -30 deg about x", TurnedPairs(make, "x", -30.0), n),
        ]

    few = SimulationConfig(n_samples=1000)
    return [
        one("office-z30", "office room, target turned by 30 deg about z (gravity aligned)", methods=ALL_METHODS),
        one("office-x30", "office room, target turned by -30 deg about x", methods=ALL_METHODS),
        *room("noise", "one office room, noise drawn anew", OnePlace("office-random"), 100),
        *room("inside", "office room with obstacles inside", Simulated("office-inside", few), 10),
        *room("printed", "one room, obstacles inside, printed noise", OnePlace("office-inside", AS_PRINTED), 20),
        one("table-map", "table, rows along against rows across, 20 deg about y and z", Simulated("table"),
            methods=ALL_METHODS),
        one("table-msac", "one table, MSAC drawn anew", OnePlace("table", is_noise_drawn=False)),
        one("table-robot", "robot in circles 0.05 m above the table, in the table's map", methods=ALL_METHODS),
        one("corridor", "a stretch of corridor walked twice by dead reckoning", methods=ALL_METHODS),
        one("corridor-msac", "one corridor, MSAC drawn anew", OnePlace("corridor", is_noise_drawn=False)),
    ]  # fmt: skip


def _refusals() -> list[Experiment]:
    """Pairs that nothing must be accepted for."""

    def one(name: str, title: str, make: Any, methods: tuple[str, ...], dataset: str | None = None) -> Experiment:
        return Experiment(name, title, "refusals", make, 20, methods, dataset=dataset)

    return [
        one("nowhere", "two different rooms", Simulated("nowhere"), ALL_METHODS),
        one("uniform", "Earth's field and noise alone", Simulated("uniform"), MAIN_METHODS),
        one("elsewhere", "two places of a building (CEA)", CeaElsewhere(), MAIN_METHODS, "cea"),
    ]


# The harder table: what is varied, its unit, the scenario, and the settings by value.
Sweep = tuple[str, str, str, dict[float, dict[str, Any]]]
SWEEPS: tuple[Sweep, ...] = (
    ("rotation", "deg, about a random axis", "office-random",
     {deg: {"target_turn": float(np.radians(deg))} for deg in (0, 30, 90, 180)}),
    ("overlap", "share, of the target's region that the base covers", "office-overlap",
     {share: {"overlap": share} for share in (1.0, 0.7, 0.5, 0.3, 0.2)}),
    ("noise", "uT", "office-random", {ut: {"noise_sd": 1e-6 * ut} for ut in (0.1, 1.0, 3.0, 10.0)}),
    ("samples", "number, in each survey", "office-random", {n: {"n_samples": int(n)} for n in (100, 200, 400, 1000)}),
    ("height", "m, between two planes", "planar", {gap: {"plane_gap": gap} for gap in (0.0, 0.1, 0.2, 0.4)}),
    ("drift", "m per sqrt(m), of dead reckoning", "corridor",
     {rate: {"pose_drift": rate} for rate in (0.0, 0.02, 0.05, 0.1)}),
    ("bias", "uT, of the target's sensor on each axis, with 3 % of scale", "office-random",
     {ut: {"bias": (1e-6 * ut, -1e-6 * ut, 1e-6 * ut), "scale": 0.03} for ut in (0.5, 2.0, 5.0)}),
    ("moved", "share, of the sources, between the surveys", "office-random",
     {share: {"moved_sources": share} for share in (0.1, 0.2, 0.4)}),
)  # fmt: skip


def _harder() -> list[Experiment]:
    """One condition varied at a time."""
    return [
        Experiment(
            f"{what}-{value:g}", f"{scenario}: {what} {value:g} {unit}", what,
            Simulated(scenario, SimulationConfig.model_validate(settings)), 8, MAIN_METHODS,
            WALK if scenario == "corridor" else Tolerance(), value,
        )
        for what, unit, scenario, values in SWEEPS for value, settings in values.items()
    ]  # fmt: skip


def _recorded() -> list[Experiment]:
    """Public recordings; what the data themselves can tell stands beside each."""

    def one(
        name: str, title: str, make: Any, n_seeds: int, max_m: float, floor: str, max_deg: float = 3.0
    ) -> Experiment:
        dataset, tolerance = name.split("-", maxsplit=1)[0], Tolerance(max_m, max_deg)
        return Experiment(
            name, title, "recordings", make, n_seeds, REAL_METHODS, tolerance, dataset=dataset, floor=floor
        )

    cea, aalto = "17-52 mm, 0.15-0.30 deg", "9-34 mm, 0-1.2 deg"
    runs = {
        "aalto-same": ("invensense-1", "invensense-2"), "aalto-other-sensor": ("trivisio-1", "invensense-2"),
        "aalto-run4": ("invensense-1", "invensense-4"),
    }  # fmt: skip
    return [
        one("cea-floor1", "areas of 10-20 m, walk one / walk two", CeaArea(1), 8, 0.25, cea),
        one("cea-floor2", "areas of 10-20 m, walk one / walk two", CeaArea(2), 8, 0.25, cea),
        *(one(name, f"{b} / {t}", TwoRecordings("aalto", b, t), 1, 0.10, aalto) for name, (b, t) in runs.items()),
        one("jidling-halves", "first / second half", Halves("jidling", "volume"), 1, 0.06, "13-25 mm, 0.9-2.0 deg"),
        *(
            one(f"kok-{name}", "first / second half", Halves("kok", name), 1, 0.4, "poses drift 100-200 mm")
            for name in ("eight", "square", "library")
        ),
        one(
            "kaist-interleaved", "areas of 20 m of one pass, every second sample / the others",
            Interleaved("kaist", "floor", 20.0), 4, 0.6, "grid of 0.6 m", 5.0,
        ),
    ]  # fmt: skip


def _mapped() -> list[Experiment]:
    """Fields predicted where nothing was measured."""

    def one(name: str, title: str, make: Any, n_seeds: int, dataset: str | None = None) -> Experiment:
        return Experiment(name, title, MAPPING, make, n_seeds, tuple(PREDICTORS), dataset=dataset)

    return [
        one("map-room", "room, no source inside", SimulatedField("office-random"), 4),
        one("map-furnished", "room with furniture inside", SimulatedField("office-inside"), 4),
        one("map-plane", "0.1 m above a planar survey", SimulatedField("planar", above=0.1), 4),
        one("map-table", "table over magnets", SimulatedField("table"), 4),
        one("map-cea", "CEA, walk one predicts walk two", RecordedField("cea", "training", "test"), 1, "cea"),
        one("map-jidling", "jidling, tenths left out", RecordedField("jidling", "volume", every=4), 3, "jidling"),
        one("map-kok", "Kok library, tenths left out", RecordedField("kok", "library"), 3, "kok"),
    ]


# Title of each axis, and what is behind it.
SWEEP_AXES = {what: f"{what} ({unit.partition(',')[0]})" for what, unit, _, _ in SWEEPS}
SWEEP_WORDS = {what: f"Scenario {scenario}; {what}: {unit}." for what, unit, scenario, _ in SWEEPS}

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment for experiment in (*_published(), *_refusals(), *_harder(), *_recorded(), *_mapped())
}
QUICK_PREFIX = "quick-"


def _quick(name: str, make: Any, methods: tuple[str, ...]) -> Experiment:
    """Make an experiment of few seeds."""
    full, n_samples = EXPERIMENTS[name], (make.make if isinstance(make, TurnedPairs) else make).config.n_samples
    title = f"{full.title}; {n_samples} samples"
    return Experiment(QUICK_PREFIX + name, title, full.group, make, 2, methods, full.tolerance)


# Under two minutes on one core: smaller surveys, few seeds.
QUICK: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        _quick("office-x30", Simulated("office-x30", SimulationConfig(n_samples=600)), (*MAIN_METHODS, "gicp")),
        _quick("noise-x30", TurnedPairs(OnePlace("office-random", SimulationConfig(n_samples=600)), "x", -30.0),
               MAIN_METHODS),
        _quick("nowhere", Simulated("nowhere", SimulationConfig(n_samples=400)), ("default", "paper")),
    )
}  # fmt: skip
