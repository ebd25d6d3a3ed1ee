# SPDX-License-Identifier: BSD-3-Clause
"""An experiment: what is asked, how often, and when an answer counts as right."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """What one trial is about.

    Attributes
    ----------
    base, target : Survey
        Each in its own frame.
    T_base_target : RigidTransform
        The truth, as exact as the data know it.
    accept : bool
        Whether there is anything to be found.
    """

    base: Survey
    target: Survey
    T_base_target: RigidTransform
    accept: bool = True


class PairMaker(Protocol):
    """Where pairs come from; its ``repr`` says all that a pair depends on besides seed and recordings."""

    def __call__(self, seed: int, recordings: Path | None) -> Pair:
        """Give the pair of a seed; `recordings` is a folder of public recordings (None: the cache)."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far an answer may be off and still be right.

    Attributes
    ----------
    distance : float, m
        At the centroid of the target's samples.
    angle_deg : float
    """

    distance: float = 0.10
    angle_deg: float = 5.0


@dataclass(frozen=True, slots=True)
class Experiment:
    """One row of a table, or one point of a curve.

    Attributes
    ----------
    name : str
        Unique, as typed on the command line.
    title : str
        What is asked, in a few words.
    group : str
        Table or curve it belongs to.
    make : PairMaker
    n_seeds : int
        Trials of the full run; seeds 0, 1, ...
    methods : tuple of str
        Names of the methods that are asked.
    tolerance : Tolerance
    value : float or None
        Where it is one point of a curve: its place on the axis, in the unit of the group.
    dataset : str or None
        Public recording that it needs.
    floor : str
        Accuracy of the data themselves, in words.
    """

    name: str
    title: str
    group: str
    make: PairMaker
    n_seeds: int
    methods: tuple[str, ...]
    tolerance: Tolerance = field(default_factory=Tolerance)
    value: float | None = None
    dataset: str | None = None
    floor: str = ""
