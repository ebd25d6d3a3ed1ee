# SPDX-License-Identifier: BSD-3-Clause
"""A piece of path may begin anywhere in a map: every place and heading is scored, the best are refined and replayed.

Where gravity is known four numbers are searched; the sensor's bias, linear in the readings, is solved for at each.
Where it is not, pairs of points propose poses, as for a walk in a registration, of a sensor whose bias is small.
"""

import numpy as np

from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePriorConfig, pose_prior
from magmatch.estimation.walk import walk_of
from magmatch.geometry import rotation_matrix, skew
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import FIT, follow
from magmatch.localization.start.grid_score import UNKNOWN, score_all
from magmatch.localization.start.least_squares import STRETCH, Priors, refine_all
from magmatch.localization.state import BIAS, Model, hypotheses, start_covariance
from magmatch.preparation.odometry.drift import LEVEL_SD
from magmatch.registration.search.pair_search import pair_search
from magmatch.typing import Points, Scalars, Vector3

# Headings tried, and how many bins of path make one that is scored.
N_HEADINGS, SCORED_EVERY = 60, 2
# Residuals of a pose on the grid, and along the refinement, as a share of the field's spread.
SCORE_SD, SCHEDULE = 0.45, (0.55, 0.42, 0.35, *[0.28] * 5)
# How well a refined start is known: field lengths, and rad. Starts nearer than that are one.
START_SD = (0.25, 0.09)
# Of the scores' best, in one cell of a field length and so many headings.
PER_CELL, HEADINGS_PER_CELL = 2, 4


def search(
    known: KnownMap, model: Model, steps: np.ndarray, config: LocalizerConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Distinct hypotheses for the end of a stretch of path that began anywhere, each replayed along all of it.

    Gives the bank (k,) of HYPOTHESIS, of which the last half has a sensor of unknown bias and the first one that was
    calibrated, and their FIT (n, k).
    """
    if not config.is_gravity_aligned:
        return _replay(known, model, steps, *_by_pairs(known, steps), config)
    every = slice((len(steps) - 1) % SCORED_EVERY, None, SCORED_EVERY)
    places, headings = _score(known, _stretch_of(known, steps[every]), config)
    places, headings, scales = _refine(known, _stretch_of(known, steps), places, headings, config)
    return _replay(known, model, steps, _about(known.up, headings) @ known.R_model_map, places, scales, config)


def _by_pairs(known: KnownMap, steps: np.ndarray) -> tuple[np.ndarray, Points, Scalars]:
    """Poses of the odometry's frame under which pairs of points agree: turns, places of the last bin, scales."""
    path = Survey(steps["p"], np.einsum("nij,nj->ni", steps["R"], steps["z"]))
    walk = walk_of(path, known.length)
    base, table = known.index.base, known.index.walks.table
    prior = pose_prior(PosePriorConfig(), base.T_map_model, walk.T_survey_walk, known.volume)
    found = pair_search(base, table, walk, prior, np.random.default_rng(0))
    poses = [T * walk.T_survey_walk.inv() for T in found.poses]
    turns = np.array([rotation_matrix(T) for T in poses]).reshape(-1, 3, 3)
    return turns, np.array([T.apply(steps["p"][-1]) for T in poses]).reshape(-1, 3), np.zeros(len(poses))


def _stretch_of(known: KnownMap, steps: np.ndarray) -> np.ndarray:
    """Bins in axes with the map's up and the odometry's heading."""
    stretch = np.zeros(len(steps), STRETCH)
    stretch["R"] = known.R_model_map @ steps["R"]
    stretch["q"] = (steps["p"] - steps["p"][-1]) @ known.R_model_map.T
    stretch["f"] = np.einsum("nij,nj->ni", stretch["R"], steps["z"])
    return stretch


def _about(up: Vector3, angles: Scalars) -> np.ndarray:
    """Rotations about the vertical, (n, 3, 3)."""
    K, s, c = skew(up), np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1 - c) * (K @ K))


def _score(known: KnownMap, stretch: np.ndarray, config: LocalizerConfig) -> tuple[Points, Scalars]:
    """Best places and headings of the last bin."""
    headings = 2 * np.pi * np.arange(N_HEADINGS) / N_HEADINGS
    turns = _about(known.up, headings)
    turned = np.zeros((N_HEADINGS, len(stretch)), STRETCH)
    for vectors in ("q", "f"):
        turned[vectors] = stretch[vectors] @ np.swapaxes(turns, 1, 2)
    turned["R"] = turns[:, None] @ stretch["R"]
    score, sd2 = np.zeros((len(known.anchors), N_HEADINGS)), (SCORE_SD * known.field_sd) ** 2
    ridges = np.array([sd2 / bias_sd**2 for bias_sd in known.bias_sds(config)])
    score_all(known.anchors, turned, known.ground, sd2, ridges, score)
    order = np.argsort(score, axis=None, kind="stable")[: 20 * config.n_starts]
    anchor, heading = np.unravel_index(order[score.ravel()[order] < UNKNOWN], score.shape)
    cells = np.column_stack([np.floor(known.anchors[anchor] / known.length), heading // HEADINGS_PER_CELL])
    counts: dict[tuple[float, ...], int] = {}
    kept = []
    for row, cell in enumerate(map(tuple, cells)):
        counts[cell] = counts.get(cell, 0) + 1
        if counts[cell] <= PER_CELL:
            kept.append(row)
    kept = kept[: config.n_starts]
    return known.anchors[anchor[kept]], headings[heading[kept]]


def _refine(
    known: KnownMap, stretch: np.ndarray, places: Points, headings: Scalars, config: LocalizerConfig
) -> tuple[Points, Scalars, Scalars]:
    """Settle place, heading and scale by robust least squares; distinct ones, best first."""
    cost, found = np.zeros(len(places)), np.column_stack([places, headings, np.zeros((len(places), 4))])
    height_sd = LEVEL_SD if config.is_planar else 0.5 * known.length
    priors = Priors(config.bias_sd, config.odometry.scale_sd, height_sd, known.length)
    refine_all(found, stretch, known.ground, np.array(SCHEDULE) * known.field_sd, priors, cost)
    kept: list[int] = []
    for row in np.argsort(cost, kind="stable"):
        apart = np.linalg.norm(found[kept, :3] - found[row, :3], axis=1)
        turn = np.abs((found[kept, 3] - found[row, 3] + np.pi) % (2 * np.pi) - np.pi)
        if cost[row] < UNKNOWN and not ((apart < START_SD[0] * known.length) & (turn < START_SD[1])).any():
            kept.append(int(row))
    kept = kept[: config.n_hypotheses]
    return found[kept, :3], found[kept, 3], found[kept, 4]


def _replay(
    known: KnownMap, model: Model, steps: np.ndarray, turns: np.ndarray, places: Points, scales: Scalars,
    config: LocalizerConfig,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Take hypotheses from the beginning to the end: the odometry's frame turned, the last bin put there."""
    n = len(places)
    bank = hypotheses(2 * n)
    sd = START_SD[0] * known.length, START_SD[1]
    bank["P"] = start_covariance(known.up, sd, config)
    for rows, bias in zip((slice(n), slice(n, None)), known.bias_sds(config), strict=True):
        bank["R"][rows] = turns @ steps["R"][0]
        bank["p"][rows] = places + (1 + scales[:, None]) * (turns @ (steps["p"][0] - steps["p"][-1]))
        bank["P"][rows, BIAS : BIAS + 3, BIAS : BIAS + 3] = bias**2 * np.eye(3)
    # One of two sensors, any place and turn: against what the start's own Gaussian spans.
    n_turns, turn_volume = (1, 2 * np.pi) if config.is_gravity_aligned else (3, 8 * np.pi**2)
    spanned = (3 + n_turns) / 2 * np.log(2 * np.pi) + 3 * np.log(sd[0]) + n_turns * np.log(sd[1])
    bank["earlier"] = spanned - np.log(2 * turn_volume * known.volume)
    fit = np.zeros((len(steps), len(bank)), FIT)
    follow(bank, known, model, steps, fit, moves_first=False)
    return bank, fit
