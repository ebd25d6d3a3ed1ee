# SPDX-License-Identifier: BSD-3-Clause
"""How probable it is that a pose is right: a logistic model of what its evidence looks like.

The log odds of `evidence.py` are honest about the data and naive about the models: their size is no probability. The
weights below were fitted by ``benchmarks/experiments/calibrate_probability.py`` to pairs of which the truth is
known, and its report on other pairs is in ``docs/results.md``.
"""

import numpy as np

# Of walks: one; asinh(log odds / 10); ln of the normalised residual; the share of the walk inside the map. Right is
# the right place here, within a correlation length: how far the pose may be off there is the covariance's to say.
WALK_WEIGHTS = np.array([-1.9, 7.3, -0.3, 2.9])
# Of: one; the margin over chance, asinh(nats / 10); how far residuals exceed what noise explains, ln; the share of
# informative cells that agree.
WEIGHTS = np.array([-3.0, 3.5, -2.3, 0.3])
# A rival behind by this share of the best pose's odds is a factor e less probable: poses that explain a field equally
# well differ by what their edges happen to cover, and the more so the more there is to explain.
RELATIVE_TEMPERATURE = 1 / 12
# Odds of less than this are compared as if they were this, nats.
MIN_ODDS = 15.0


def features(log_odds: float, decoy_evidence: float | None, misfit: float, agreeing_share: float) -> np.ndarray:
    """What the model sees of a pose."""
    margin = log_odds - max(0.0, decoy_evidence or 0.0)
    return np.array([1.0, np.arcsinh(max(margin, -50.0) / 10), np.log(np.clip(misfit, 0.5, 20.0)), agreeing_share])


def pose_probability(log_odds: float, decoy_evidence: float | None, misfit: float, agreeing_share: float) -> float:
    """Probability that a pose is right, were there no other like it."""
    if not np.isfinite(log_odds):
        return 0.0
    z = float(features(log_odds, decoy_evidence, misfit, agreeing_share) @ WEIGHTS)
    return float(1 / (1 + np.exp(-z)))


def walk_probability(log_odds: float, residual: float, coverage: float) -> float:
    """Probability that a walk's pose is in the right place, were there no other like it."""
    if not np.isfinite(log_odds):
        return 0.0
    seen = np.array([1.0, np.arcsinh(log_odds / 10), np.log(np.clip(residual, 0.3, 20.0)), coverage])
    return float(1 / (1 + np.exp(-seen @ WALK_WEIGHTS)))


def shares(log_odds: list[float]) -> list[float]:
    """How the probability is divided among poses that exclude each other."""
    odds = np.maximum(log_odds, -1e6)
    weights = np.exp((odds - odds[0]) / max(odds[0], MIN_ODDS) / RELATIVE_TEMPERATURE)
    return [float(w) for w in weights / weights.sum()]
