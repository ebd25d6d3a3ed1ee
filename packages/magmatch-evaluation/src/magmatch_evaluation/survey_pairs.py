# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of surveys with the true transform, from the simulator and from public recordings.

A recording's target is moved by a random SE(3), which is the truth. The ``repr`` of what makes pairs says all that a
pair depends on besides its seed and the folder of recordings (None: the cache).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.geometry import random_transform
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate

# Areas of fewer samples of either walk are drawn again.
MIN_SAMPLES = 300
# Different places have no sample nearer than this, m.
APART = 15.0
# How rough the start of methods that only refine is: what a floor plan and a compass give.
ROUGH_ANGLE_DEG, ROUGH_DISTANCE = 10.0, 0.3
ROUGH_WORDS = f"started {ROUGH_ANGLE_DEG:.0f} deg and {ROUGH_DISTANCE} m off the truth"


@dataclass(frozen=True, eq=False, slots=True)
class SurveyPair:
    """Two surveys, each in a frame of its own, the true transform, and whether there is anything to be found."""

    base: Survey
    target: Survey
    T_base_target: RigidTransform
    accept: bool = True

    def rough_start(self, seed: int) -> RigidTransform:
        """Give the truth, turned and shifted at the target's place by a known amount in a random direction."""
        rng = np.random.default_rng([seed, 1])
        axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        center = self.target.centroid
        turn = Rotation.from_rotvec(np.radians(ROUGH_ANGLE_DEG) * axis)
        shift = center + ROUGH_DISTANCE * way - turn.apply(center)
        return self.T_base_target * RigidTransform.from_components(shift, turn)


@dataclass(frozen=True, slots=True)
class Simulated:
    """A named scenario with settings of its own; each seed draws a place, both paths, the frames and the noise."""

    scenario: str
    config: SimulationConfig = field(default_factory=SimulationConfig)

    def __call__(self, seed: int, recordings: Path | None = None) -> SurveyPair:  # noqa: ARG002  (as all that make pairs)
        """Give the pair of a seed."""
        pair = simulate(self.scenario, seed, self.config)
        return SurveyPair(pair.base, pair.target, pair.T_base_target, pair.accept)


@dataclass(frozen=True, slots=True)
class OnePlace:
    """One place of a named scenario for all seeds: they draw both sensors' noise, or only what methods draw."""

    scenario: str
    config: SimulationConfig = field(default_factory=SimulationConfig)
    is_noise_drawn: bool = True
    place: int = 1000  # seed of the scenario

    def __call__(self, seed: int, recordings: Path | None = None) -> SurveyPair:  # noqa: ARG002
        """Give the pair of a seed."""
        if not self.is_noise_drawn:
            return Simulated(self.scenario, self.config)(self.place)
        pair = Simulated(self.scenario, self.config.model_copy(update={"noise_sd": 0.0}))(self.place)
        rng = np.random.default_rng([seed, self.place])
        base, target = (
            replace(s, field=s.field + self.config.noise_sd * rng.standard_normal(s.field.shape))
            for s in (pair.base, pair.target)
        )
        return replace(pair, base=base, target=target)


@dataclass(frozen=True, slots=True)
class TurnedPairs:
    """Pairs whose target's axes are turned by a known angle about one of the base's, its origin half a metre away."""

    make: Simulated | OnePlace
    axis: str
    angle_deg: float

    def __call__(self, seed: int, recordings: Path | None = None) -> SurveyPair:
        """Give the pair of a seed."""
        pair = self.make(seed, recordings)
        turn = Rotation.from_euler(self.axis, self.angle_deg, degrees=True)
        T_base_target = RigidTransform.from_components([0.3, -0.4, 0.0], turn)
        target = pair.target.transformed(T_base_target.inv() * pair.T_base_target)
        return replace(pair, target=target, T_base_target=T_base_target)


@dataclass(frozen=True, slots=True)
class CeaArea:
    """A square area of one floor (1 or 2), centred on walk two, its side drawn (m): walk one against walk two."""

    floor: int
    sides: tuple[float, float] = (10.0, 20.0)

    def __call__(self, seed: int, recordings: Path | None) -> SurveyPair:
        """Give the pair of a seed."""
        walks, rng = load("cea", recordings), np.random.default_rng([seed, self.floor])
        one, two = walks[f"training-floor{self.floor}"], walks[f"test-floor{self.floor}"]
        while True:
            center, side = two.positions[rng.integers(len(two)), :2], rng.uniform(*self.sides)
            base, target = area(one, center, side), area(two, center, side)
            if min(len(base), len(target)) >= MIN_SAMPLES:
                return _moved(base, target, rng)


@dataclass(frozen=True, slots=True)
class CeaElsewhere:
    """Two areas of the building that have nothing in common: nothing must be accepted."""

    sides: tuple[float, float] = (8.0, 15.0)

    def __call__(self, seed: int, recordings: Path | None) -> SurveyPair:
        """Give the pair of a seed."""
        walks, rng = load("cea", recordings), np.random.default_rng([seed, 3])
        while True:
            base, target = (
                area(survey, survey.positions[rng.integers(len(survey)), :2], rng.uniform(*self.sides))
                for survey in (walks[f"{walk}-floor{rng.integers(1, 3)}"] for walk in ("training", "test"))
            )
            if min(len(base), len(target)) < 100:
                continue
            nearest, _ = cKDTree(base.positions[:, :2]).query(target.positions[:, :2])
            if np.min(nearest) > APART:
                return _moved(base, target, rng, accept=False)


@dataclass(frozen=True, slots=True)
class TwoRecordings:
    """Two recordings of one dataset that share a frame; seeds differ in the target's frame only."""

    dataset: str
    base: str
    target: str

    def __call__(self, seed: int, recordings: Path | None) -> SurveyPair:
        """Give the pair of a seed."""
        surveys = load(self.dataset, recordings)
        return _moved(surveys[self.base], surveys[self.target], np.random.default_rng(seed))


@dataclass(frozen=True, slots=True)
class Halves:
    """First half of a recording against its second half; seeds differ in the target's frame only."""

    dataset: str
    name: str

    def __call__(self, seed: int, recordings: Path | None) -> SurveyPair:
        """Give the pair of a seed."""
        return in_halves(load(self.dataset, recordings)[self.name], np.random.default_rng(seed))


@dataclass(frozen=True, slots=True)
class Interleaved:
    """Every second sample of an area, its side in m, against the others: one pass, so both share its faults."""

    dataset: str
    name: str
    side: float

    def __call__(self, seed: int, recordings: Path | None) -> SurveyPair:
        """Give the pair of a seed."""
        survey, rng = load(self.dataset, recordings)[self.name], np.random.default_rng(seed)
        while True:
            cut = area(survey, survey.positions[rng.integers(len(survey)), :2], self.side)
            if len(cut) >= MIN_SAMPLES:
                is_even = np.arange(len(cut)) % 2 == 0
                return _moved(cut.subset(is_even), cut.subset(~is_even), rng)


@lru_cache(maxsize=2)
def load(dataset: str, recordings: Path | None) -> Mapping[str, Survey]:
    """Recordings of a dataset, verified once a process."""
    return load_recordings(dataset, recordings)


def in_halves(survey: Survey, rng: np.random.Generator) -> SurveyPair:
    """Pair the first half of a recording with its second half."""
    is_first = np.arange(len(survey)) < len(survey) // 2
    return _moved(survey.subset(is_first), survey.subset(~is_first), rng)


def area(survey: Survey, center: np.ndarray, side: float) -> Survey:
    """Cut a square out of a survey."""
    return survey.subset(np.all(np.abs(survey.positions[:, :2] - center) < side / 2, axis=1))


def _moved(base: Survey, target: Survey, rng: np.random.Generator, *, accept: bool = True) -> SurveyPair:
    """Give the target a frame of its own."""
    T_base_target = random_transform(rng)
    return SurveyPair(base, target.transformed(T_base_target.inv()), T_base_target, accept)
