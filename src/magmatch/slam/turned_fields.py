# SPDX-License-Identifier: BSD-3-Clause
"""Logs whose field is turned about the vertical against that of the others, once all are in one frame.

Dead reckoning takes a phone to be held with its upper end forward. One that is held sideways walks along its path
with a field that is turned by the angle between, alike at every sample. Fixed points may tie it to the others all the
same, and the map is the mean of fields that contradict each other. Where two logs pass close to each other, the field
of one is that of the other, turned, plus what each sensor's bias still adds.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from magmatch.data.frame_mistakes import MOUNT
from magmatch.data.survey import Survey
from magmatch.errors import in_short
from magmatch.estimation.gauss_newton import student_weights
from magmatch.estimation.model_prior import HARD_IRON_SD
from magmatch.estimation.walk import bin_along_path, bin_means

log = logging.getLogger(__name__)

# Field lengths: of a bin, and within which two logs pass the same place.
BIN, NEAR = 0.5, 0.25
# Fewest bins of a log near another: the fit has eight unknowns.
MIN_MET = 20
# Share of the difference's variance that may be left once the turn is taken out: of half the difference.
LEFT = 0.25
# Log odds of a turn, at least, nats: a thousand to one.
LEAST_ODDS = float(np.log(1000.0))
# Steps of the reweighting, and the least variance, T^2: of a nanotesla.
STEPS, LEAST = 10, 1e-18
# Median of the squared norm of two normal numbers, in their variance.
MEDIAN2 = float(2 * np.log(2.0))


@dataclass(frozen=True, eq=False, slots=True)
class _Passed:
    """What a log measured, in bins along its path; horizontal vectors are complex numbers, east plus i north."""

    tree: cKDTree  # of the bins' places
    field: np.ndarray  # (n,), T
    axes: np.ndarray  # (n, k): of its sensor, in which its bias is constant; without orientations, those of the frame


def warn_of_turned_fields(
    logs: Sequence[Survey], components: Sequence[Sequence[int]], length: float, n_known: int = 0
) -> None:
    """Name logs whose field is turned against that of the others; ``length`` (m): over which the field changes.

    Nothing is said again of the first ``n_known`` logs among themselves.
    """
    for group in components:
        if max(group) < n_known or len(group) == 1:
            continue
        for one, angle, others in turned_logs([logs[k] for k in group], length):
            if max(group[one], *(group[k] for k in others)) < n_known:
                continue
            against = ", ".join(in_short([logs[group[k]].name for k in others]))
            words = (
                "%s: its field is turned by %.0f degrees about the vertical against that of %s at the same places: "
                "was one of the phones held another way? Hold them with the upper end forward, or leave the log out"
            )
            log.warning(words, logs[group[one]].name, angle, against)


def turned_logs(logs: Sequence[Survey], length: float) -> list[tuple[int, float, list[int]]]:
    """Logs of one frame whose field is turned, by how much (deg), and against which others.

    One log that is turned contradicts the others, which agree with each other: the most contradicted one is taken out
    until the rest agree.
    """
    passed, turns = [_passed(survey, length) for survey in logs], np.full((len(logs), len(logs)), np.nan)
    for a, b in combinations(range(len(logs)), 2):
        if (turn := _turn_between(passed[a], passed[b], length)) is not None:
            turns[a, b], turns[b, a] = turn, -turn
    is_turned, found = np.abs(turns) > 0, []
    balance = is_turned.astype(np.int64) - (turns == 0)
    left = np.ones(len(logs), dtype=bool)
    while left.any():
        contradicted = np.where(left, balance[:, left].sum(axis=1), 0)
        # Of two that contradict each other, the one that came later is named.
        one = len(logs) - 1 - int(np.argmax(contradicted[::-1]))
        if contradicted[one] <= 0:
            break
        left[one] = False
        others = np.flatnonzero(is_turned[one] & left)
        found.append((one, float(np.degrees(np.angle(np.exp(1j * turns[one, others]).sum()))), others.tolist()))
    return found


def _passed(survey: Survey, length: float) -> _Passed:
    rows = bin_along_path(np.ascontiguousarray(survey.positions), BIN * length)
    field = bin_means(survey.field, rows)
    axes = np.broadcast_to(np.eye(2), (len(field), 2, 2))
    if survey.orientations is not None:
        axes = bin_means(survey.orientations.as_matrix(), rows)[:, :2]
    return _Passed(
        cKDTree(bin_means(survey.positions, rows)), field[:, 0] + 1j * field[:, 1], axes[:, 0] + 1j * axes[:, 1]
    )


def _turn_between(one: _Passed, other: _Passed, length: float) -> float | None:
    """Turn of one log's field against another's, rad: 0 where none is sure, None where they hardly meet.

    A turn below `MOUNT` is what hands do, and what the checks of a log's axes call misalignment.
    """
    apart, there = other.tree.query(one.tree.data, distance_upper_bound=NEAR * length)
    here = np.flatnonzero(np.isfinite(apart))
    if len(here) < MIN_MET:
        return None
    met = np.asarray(there)[here]
    f, g, axes = one.field[here], other.field[met], np.hstack([one.axes[here], other.axes[met]])
    free, _ = _biases(np.column_stack([f, 1j * f, axes]), g, 2)
    turn = float(np.arctan2(free[1], free[0]))
    (before, s_before), (after, s_after) = _biases(axes, g - f), _biases(axes, g - np.exp(1j * turn) * f)
    # Bins within a length tell the same.
    odds = BIN * len(here) * np.log(s_before / s_after) + (before @ before - after @ after) / (2 * HARD_IRON_SD**2)
    is_turned = abs(turn) >= np.radians(MOUNT) and s_after <= LEFT * s_before and odds >= LEAST_ODDS
    return -turn if is_turned else 0.0


def _biases(A: np.ndarray, y: np.ndarray, n_free: int = 0) -> tuple[np.ndarray, float]:
    """Biases, after so many free unknowns, that explain complex numbers robustly; and the variance left, T^2."""
    A, b = np.concatenate([A.real, A.imag]), np.concatenate([y.real, y.imag])
    prior = np.diag(np.arange(A.shape[1]) >= n_free) / HARD_IRON_SD**2
    w, s, x = np.ones(len(y)), HARD_IRON_SD**2, np.zeros(A.shape[1])
    for _ in range(STEPS):
        AtW = A.T * np.tile(w, 2)
        x = np.linalg.lstsq(AtW @ A + s * prior, AtW @ b, rcond=None)[0]  # a vertical field tells no turn
        d2 = (np.reshape(b - A @ x, (2, -1)) ** 2).sum(axis=0)
        s = max(float(np.median(d2)) / MEDIAN2, LEAST)
        # Weights are one where nothing is off, so that the prior of the biases counts as stated.
        w = student_weights(d2 / s, 2) / student_weights(np.zeros(1), 2)
    return x, s
