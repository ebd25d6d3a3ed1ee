# SPDX-License-Identifier: BSD-3-Clause
"""The mistake that turned a survey's vectors is found: each known one is undone, and what scatter is left compared.

A hypothesis is a convention (which rotations turned which readings) and the sensor's axes. The vectors are linear in
the nine numbers of a matrix of axes, so one Gram matrix gives the scatter of every permutation and sign, and of every
rotation between them. Reversing all three axes changes no scatter: the 48 ways are 24 hypotheses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from magmatch.data.sensor_axes import RESOLVED
from magmatch.data.units import CLOCKS_APART, ORDINARY_FIELD
from magmatch.geometry import DIRECTIONS, GENERATORS, LINEAR_TURN
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

# Scatter with a mistake undone over that as declared, below which it was made: what is declared gets the benefit of a
# tenth, and so does each other hypothesis against the best.
LESS = 0.9
# Scatters nearer than this are equal. Two mistakes that explain the vectors better than one, but not by a tenth,
# leave both in doubt; of two hypotheses nearer than a tenth, one is better if it is so in every part.
TIE = 0.99
# A mistake is made throughout a survey: so many parts of it tell the same one.
N_PARTS = 3
N_ASKED, N_NEIGHBOURS = 1500, 9
# Smallest singular value over the largest from which on directions of constants are told apart.
DISTINCT = 1e-3
# Lags of the clocks that are tried either way.
N_LAGS = 20
# Deg: a smaller turn between sensor and orientations is misalignment, which `magmatch prepare` estimates.
MOUNT = 20.0
# Newton's steps to the best rotation: no rotation is farther than 1.1 rad from all of AXES.
STEPS = 12
OWN, DECLARED = "x, y, z", "declared"


def named(axes: np.ndarray) -> str:
    """Name the axes that the rows are, such as ``-y, x, z``."""
    return ", ".join(f"{'-' * int(row.min() < 0)}{'xyz'[np.abs(row).argmax()]}" for row in axes)


# The 24 permutations and signs of the axes that stay right-handed.
AXES = {named(axes): axes for axes in np.rint(Rotation.create_group("O").as_matrix())}


@dataclass(frozen=True, eq=False, slots=True)
class Turned:
    """A convention: readings, what turns them into the survey's frame, and what turns the sensor's own constant."""

    readings: Vectors
    turned_by: Rotation | None  # None: they are in the survey's frame
    carried_by: Rotation
    any_axes: bool = False  # whether the readings' axes may be others, too

    def subset(self, read: slice, posed: slice) -> "Turned":
        """Keep some readings, and as many turns of them."""
        turned_by = None if self.turned_by is None else self.turned_by[posed]
        return Turned(self.readings[read], turned_by, self.carried_by[posed], self.any_axes)

    def mean(self, axes: Matrix) -> Scalars:
        """Mean vector in the survey's frame, (3,), with the readings' axes so changed."""
        changed = self.readings @ axes.T
        return np.asarray((changed if self.turned_by is None else self.turned_by.apply(changed)).mean(axis=0))


@dataclass(frozen=True, slots=True)
class FrameMistake:
    """Say how the vectors would be right."""

    convention: str
    axes: str = OWN  # rows of the matrix that takes the readings to the right axes

    @property
    def n_mistakes(self) -> int:
        """Count mistakes: of conventions, and of axes."""
        return (self.convention != DECLARED) + (self.axes != OWN)


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """The remedy of a mistake: hypotheses that the motion does not tell apart, best first, or a mount."""

    hypotheses: tuple[FrameMistake, ...]
    share: float  # scatter that is left, of that as declared
    mount: Rotation | None = None  # takes the sensor's axes to those of the orientations, where no permutation does


def mistake_made(points: Points, conventions: Mapping[str, Turned]) -> Found | None:
    """The mistake whose correction scatters least; None if none does, in the whole and in each part.

    What turned once, beside one piece of steel, supports some hypothesis by chance; parts of a survey then do not
    support the same one. A constant in the sensor's axes (hard iron) is free for hypotheses that leave a field like
    the Earth's beside it; otherwise it would stand in for the Earth's. Without it more hypotheses are told apart.
    """
    whole = _Judged.of(points, conventions)
    parts: list[_Judged] = []
    told: list[Found] = []
    for free in (True, False):
        found = whole.least(free=free)
        if found is None or (not free and whole.is_beaten(found)):
            continue
        if not free and whole.declared_stands_still and not (told and found.hypotheses[0] in told[0].hypotheses):
            continue
        parts = parts or _parts(points, conventions)
        if all(part.agrees(found, free=free) for part in parts):
            left = (one for one in found.hypotheses if not _is_worse(one, found, parts, free=free))
            told.append(replace(found, hypotheses=tuple(left)))
    return min(told, key=lambda found: len(found.hypotheses), default=None)


def lag_instead(points: Points, declared: Turned, times: Scalars | None, found: Found) -> float | None:
    """The lag (s) of the readings behind the poses that scatters as little as what was found; None if none does.

    Of a carrier that turns steadily one way, readings that come late look like those of a sensor mounted turned.
    """
    if times is None or declared.turned_by is None:
        return None
    interval = max(float(np.median(np.diff(times))), np.finfo(float).tiny)
    most = min(int(CLOCKS_APART / interval), len(points) // N_PARTS)
    rows = np.unique(np.linspace(-most, most, 2 * min(most, N_LAGS) + 1).round().astype(int))
    scatter = {int(lag): _Judged.of(*_shifted(points, declared, int(lag))).scatter for lag in rows}
    as_declared, best = scatter[0], min(scatter, key=lambda lag: min(float(s[0]) for s in scatter[lag]))
    share = min(float(late[0] / now[0]) for late, now in zip(scatter[best], as_declared, strict=True))
    return best * interval if best and LESS * share <= found.share else None


def _shifted(points: Points, declared: Turned, lag: int) -> tuple[Points, dict[str, Turned]]:
    """Samples whose readings came so many samples later than their poses."""
    n = len(points)
    read, posed = slice(max(lag, 0), n + min(lag, 0)), slice(max(-lag, 0), n - max(lag, 0))
    return points[posed], {DECLARED: replace(declared.subset(read, posed), any_axes=False)}


def _is_worse(one: FrameMistake, found: Found, parts: "Sequence[_Judged]", *, free: bool) -> bool:
    """Whether a hypothesis scatters more than the best in every part of a survey."""
    best = found.hypotheses[0]
    return all(part.of_one(best, free=free) < TIE * part.of_one(one, free=free) for part in parts)


def _parts(points: Points, conventions: Mapping[str, Turned]) -> "list[_Judged]":
    """The scatter in each part of a survey."""
    ends = [len(points) * k // N_PARTS for k in range(N_PARTS + 1)]
    parts = [slice(start, end) for start, end in pairwise(ends)]
    return [
        _Judged.of(points[part], {name: one.subset(part, part) for name, one in conventions.items()})
        for part in parts
    ]


@dataclass(frozen=True, eq=False, slots=True)
class _Judged:
    """The scatter of samples under each hypothesis; in pairs, without and with a free constant of the sensor."""

    grams: Mapping[str, tuple["_Gram", "_Gram"]]  # of each convention
    earth: Mapping[str, Matrix]  # (3, 9) of each: what is constant in the survey's frame, of a matrix's numbers
    hypotheses: tuple[FrameMistake, ...]
    scatter: tuple[Scalars, Scalars]  # of each hypothesis, T^2
    declared_stands_still: bool

    @classmethod
    def of(cls, points: Points, conventions: Mapping[str, Turned]) -> "_Judged":
        near, grams, earth = _neighbours(points), {}, {}
        hypotheses, values, stands = [], [], []
        for name, one in conventions.items():
            grams[name], earth[name] = _grams(one, near)
            axes = AXES if one.any_axes else {OWN: AXES[OWN]}
            numbers = np.array(list(axes.values())).reshape(-1, 9)
            hypotheses += [FrameMistake(name, words) for words in axes]
            values.append([gram.scatter(numbers) for gram in grams[name]])
            stands.append(_stand_still(earth[name], numbers))
        fixed, free = np.concatenate(values, axis=1)
        still, declared = np.concatenate(stands), hypotheses.index(FrameMistake(DECLARED))
        free = np.where(still | (np.arange(len(still)) == declared), free, np.inf)
        return cls(grams, earth, tuple(hypotheses), (fixed, free), bool(still[declared]))

    def of_one(self, one: FrameMistake, *, free: bool) -> float:
        """Scatter under one hypothesis."""
        return float(self.scatter[free][self.hypotheses.index(one)])

    def least(self, *, free: bool) -> Found | None:
        """The fewest mistakes that scatter least, and all as many that scatter little more; None if none do."""
        scatter, declared = self.scatter[free], self.of_one(FrameMistake(DECLARED), free=free)
        n_mistakes = np.array([one.n_mistakes for one in self.hypotheses])
        fewest = int(n_mistakes[LESS * scatter <= scatter.min()].min())
        among = np.where(n_mistakes == fewest, scatter, np.inf)
        best = float(among.min())
        any_axes = dict.fromkeys(one.convention for one in self.hypotheses if one.axes != OWN)
        rotations = {name: self.grams[name][free].best_rotation() for name in any_axes if fewest or name == DECLARED}
        if rotations and min(value for _, value in rotations.values()) < LESS * min(best, declared):
            return self._mount(rotations, declared, free=free)
        # One mistake, a mount, may explain what two do.
        if fewest > 1 and LESS * rotations[DECLARED][1] <= best:
            return None
        more = scatter[n_mistakes > fewest].min(initial=np.inf)
        if fewest == 0 or not best < LESS * declared or more < TIE * best:
            return None
        alike = [self.hypotheses[k] for k in np.argsort(among, kind="stable") if LESS * among[k] <= best]
        if len(alike) == 1 and alike[0].axes != OWN:
            axes, least = rotations[alike[0].convention]
            # The permutation may only be what is nearest to a mount that the motion hardly tells.
            if least < TIE * best and _apart(axes, AXES[alike[0].axes]) > MOUNT:
                return None
        return Found(tuple(alike), best / declared)

    def _mount(self, rotations: Mapping[str, tuple[Matrix, float]], declared: float, *, free: bool) -> Found | None:
        """The rotation that scatters less than any permutation, if it is one alone; None if it is not certain."""
        axes, least = rotations[DECLARED]
        gram, mount = self.grams[DECLARED][free], Rotation.from_matrix(axes)
        others = [value for name, (_, value) in rotations.items() if name != DECLARED]
        # Nothing that is farther away scatters as little.
        turned, values = gram.rotations()
        apart = _apart(axes, turned) > MOUNT
        around = mount * Rotation.from_rotvec(np.radians(MOUNT) * DIRECTIONS)
        others += [*values[apart], *gram.scatter(around.as_matrix().reshape(-1, 9))]
        is_certain = free and mount.magnitude() > np.radians(MOUNT) and LESS * min(others) > least
        is_certain = is_certain and bool(_stand_still(self.earth[DECLARED], axes.reshape(1, 9))[0])
        return Found((), least / declared, mount) if is_certain else None

    def agrees(self, found: Found, *, free: bool) -> bool:
        """Whether these samples alone tell of the same mistake."""
        if found.mount is None:
            value = self.of_one(found.hypotheses[0], free=free)
        else:
            value = float(self.grams[DECLARED][free].scatter(found.mount.as_matrix().reshape(1, 9))[0])
        return (
            value < LESS * self.of_one(FrameMistake(DECLARED), free=free) and LESS * value < self.scatter[free].min()
        )

    def is_beaten(self, found: Found) -> bool:
        """Whether another hypothesis scatters less once a constant of the sensor is free."""
        own = min(self.of_one(found.hypotheses[0], free=free) for free in (False, True))
        return bool(self.scatter[True].min() < LESS * own)


@dataclass(frozen=True, eq=False, slots=True)
class _Gram:
    """Average products of the nine numbers of a matrix of axes, over all and between neighbours: (9, 9), T^2."""

    whole: Matrix
    near: Matrix

    @classmethod
    def of(cls, field: np.ndarray, near: tuple[Indices, Indices]) -> "_Gram":
        """Sum the products of a field (n, 3, 9), a column for each number."""
        offset = (field - field.mean(axis=0)).reshape(-1, 9)
        between = (field[near[0]] - field[near[1]]).reshape(-1, 9)
        return cls(offset.T @ offset / len(field), between.T @ between / len(near[0]))

    def scatter(self, numbers: Matrix) -> Scalars:
        """Geometric mean of the two variances, for matrices as rows (k, 9)."""
        both = (np.einsum("ki,ij,kj->k", numbers, gram, numbers) for gram in (self.whole, self.near))
        return np.asarray(np.sqrt(np.maximum(np.prod(list(both), axis=0), 0)) + RESOLVED**2)

    def best_rotation(self) -> tuple[Matrix, float]:
        """The rotation of the axes that scatters least, and its scatter."""
        turned, values = self.rotations()
        return turned[values.argmin()], float(values.min())

    def rotations(self) -> tuple[np.ndarray, Scalars]:
        """Rotations (k, 3, 3) that scatter least near each of AXES, by Newton's method, and their scatter."""
        turned = np.array(list(AXES.values()))
        for _ in range(STEPS):
            numbers = turned.reshape(-1, 9)
            change = np.einsum("kij,ajl->kail", turned, GENERATORS).reshape(-1, 3, 9)
            slope, curve = np.zeros((len(turned), 3)), np.zeros((len(turned), 3, 3))
            for gram in (self.whole, self.near):
                value = np.einsum("ki,ij,kj->k", numbers, gram, numbers) + np.finfo(float).tiny
                slope += np.einsum("kai,ij,kj->ka", change, gram, numbers) / value[:, None]
                curve += np.einsum("kai,ij,kbj->kab", change, gram, change) / value[:, None, None]
            # Directions that the motion does not determine stay where they are.
            ridge = DISTINCT**2 * np.trace(curve, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
            step = -np.linalg.solve(curve + ridge * np.eye(3), slope[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1, LINEAR_TURN / np.maximum(length, LINEAR_TURN))
            turned = turned @ Rotation.from_rotvec(step).as_matrix()
        return turned, self.scatter(turned.reshape(-1, 9))


def _apart(axes: Matrix, others: np.ndarray) -> Scalars:
    """Deg between rotations."""
    return np.degrees(np.asarray((Rotation.from_matrix(others) * Rotation.from_matrix(axes).inv()).magnitude()))


def _stand_still(earth: Matrix, numbers: Matrix) -> Mask:
    """Whether a field like the Earth's is constant in the survey's frame, for matrices of axes as rows (k, 9)."""
    return np.asarray(np.linalg.norm(numbers @ earth.T, axis=1) > ORDINARY_FIELD[0])


def _neighbours(points: Points) -> tuple[Indices, Indices]:
    """Samples, and their neighbours."""
    rows = np.linspace(0, len(points) - 1, min(N_ASKED, len(points))).astype(np.int64)
    near = np.asarray(cKDTree(points[rows]).query(points[rows], k=min(N_NEIGHBOURS + 1, len(rows)))[1])[:, 1:]
    return np.repeat(rows, near.shape[1]), rows[near.ravel()]


def _grams(one: Turned, near: tuple[Indices, Indices]) -> tuple[tuple[_Gram, _Gram], Matrix]:
    """Subtract nothing, or the best constant of the sensor; and give what is constant in the survey's frame.

    The latter is apart from a constant in the sensor's axes. Along what the sensor does not turn about: about that,
    the two cannot be told apart.
    """
    n, columns = len(one.readings), one.carried_by.as_matrix()
    turns = np.tile(np.eye(3), (n, 1, 1)) if one.turned_by is None else one.turned_by.as_matrix()
    field = (turns[:, :, :, None] * one.readings[:, None, None, :]).reshape(n, 3, 9)
    both = np.concatenate([np.tile(np.eye(3), (n, 1)), columns.reshape(-1, 3)], axis=1)
    constant, kept = _fitted(both, field.reshape(-1, 9))[:3], columns.mean(axis=0)
    centred = field - field.mean(axis=0)
    iron = _fitted((columns - kept).reshape(-1, 3), centred.reshape(-1, 9))
    free = field - columns @ iron
    return (_Gram.of(field, near), _Gram.of(free, near)), constant - kept @ (kept.T @ constant)


def _fitted(A: Matrix, b: Matrix) -> Matrix:
    """Least squares of the directions that are distinct, by the normal equations.

    Their singular values are squares; rounding is far below DISTINCT squared.
    """
    return np.asarray(np.linalg.lstsq(A.T @ A, A.T @ b, rcond=DISTINCT**2)[0])
