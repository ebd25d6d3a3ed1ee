# SPDX-License-Identifier: BSD-3-Clause
"""Pairs from public recordings: two surveys of one frame, the target moved by a random SE(3), which is the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.recordings import load_recordings
from magmatch.data.survey import Survey
from magmatch.evaluation.experiment import Pair
from magmatch.geometry import random_transform

# Areas of fewer samples of either walk are drawn again.
MIN_SAMPLES = 300
# Different places have no sample nearer than this, m.
APART = 15.0


@lru_cache(maxsize=2)
def load(dataset: str, recordings: Path | None) -> Mapping[str, Survey]:
    """Recordings of a dataset, verified once a process."""
    if recordings is None:
        return load_recordings(dataset)
    return load_recordings(dataset, recordings / dataset if (recordings / dataset).is_dir() else recordings)


@dataclass(frozen=True, slots=True)
class CeaArea:
    """A square area of one floor, centred on walk two: walk one against walk two.

    Attributes
    ----------
    floor : int
        1 or 2.
    sides : (float, float), m
        Shortest and longest side.
    """

    floor: int
    sides: tuple[float, float] = (10.0, 20.0)

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed."""
        walks, rng = load("cea", recordings), np.random.default_rng([seed, self.floor])
        one, two = walks[f"training-floor{self.floor}"], walks[f"test-floor{self.floor}"]
        while True:
            center, side = two.positions[rng.integers(len(two)), :2], rng.uniform(*self.sides)
            base, target = _area(one, center, side), _area(two, center, side)
            if min(len(base), len(target)) >= MIN_SAMPLES:
                return _moved(base, target, rng)


@dataclass(frozen=True, slots=True)
class CeaElsewhere:
    """Two areas of the building that have nothing in common: nothing must be accepted."""

    sides: tuple[float, float] = (8.0, 15.0)

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed."""
        walks, rng = load("cea", recordings), np.random.default_rng([seed, 3])
        while True:
            base, target = (
                _area(survey, survey.positions[rng.integers(len(survey)), :2], rng.uniform(*self.sides))
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

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed."""
        surveys = load(self.dataset, recordings)
        return _moved(surveys[self.base], surveys[self.target], np.random.default_rng(seed))


@dataclass(frozen=True, slots=True)
class Halves:
    """First half of a recording against its second half; seeds differ in the target's frame only."""

    dataset: str
    name: str

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed."""
        survey = load(self.dataset, recordings)[self.name]
        is_first = np.arange(len(survey)) < len(survey) // 2
        return _moved(survey.subset(is_first), survey.subset(~is_first), np.random.default_rng(seed))


@dataclass(frozen=True, slots=True)
class Interleaved:
    """Every second sample against the others: one pass, so both share its faults."""

    dataset: str
    name: str
    side: float

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed: an area of the recording, drawn anew."""
        survey, rng = load(self.dataset, recordings)[self.name], np.random.default_rng(seed)
        while True:
            cut = _area(survey, survey.positions[rng.integers(len(survey)), :2], self.side)
            if len(cut) >= MIN_SAMPLES:
                is_even = np.arange(len(cut)) % 2 == 0
                return _moved(cut.subset(is_even), cut.subset(~is_even), rng)


def _area(survey: Survey, center: np.ndarray, side: float) -> Survey:
    return survey.subset(np.all(np.abs(survey.positions[:, :2] - center) < side / 2, axis=1))


def _moved(base: Survey, target: Survey, rng: np.random.Generator, *, accept: bool = True) -> Pair:
    """Give the target a frame of its own."""
    T_base_target = random_transform(rng)
    return Pair(base, target.transformed(T_base_target.inv()), T_base_target, accept)
