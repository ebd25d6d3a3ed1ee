# SPDX-License-Identifier: BSD-3-Clause
"""The probability of each hypothesis after a stretch of path, by the evidence and decision of a registration."""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.compiled import allocating, compiled
from magmatch.estimation.posterior import Kind, log_odds
from magmatch.localization.bins import STEP
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import LatestBins
from magmatch.localization.state import BIAS, Model, predict
from magmatch.typing import COVARIANCE, POSE, VECTOR, Covariance6, Matrix, Scalars, Vector3

# The statement of a hypothesis: the fields of a `PoseEstimate`; T is T_map_body.
STATED = np.dtype([
    ("T", POSE), ("covariance", COVARIANCE), ("bias", VECTOR), ("bias_sd", VECTOR), ("scale", "f8"), ("gain", "f8"),
    ("drift", "f8"),
])  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class WeighedHypothesis:
    """A hypothesis (1,) as a decision sees it, the likeliest of those that differ by how the odometry drifts."""

    rows: tuple[int, ...]  # these, likeliest first; the evidence is that of all
    one: np.ndarray
    log_evidence: float
    misfit: float
    factor: float
    kind: Kind = "log"
    model: str = "follows the log"
    # The body itself; what else a `Hypothesis` has is not asked for: of the covariance see `covariance_of`.
    center: ClassVar[Vector3] = np.zeros(3)
    covariance: ClassVar[None] = None
    attainable: ClassVar[float] = np.nan
    overlap: ClassVar[float] = np.nan

    @property
    def T_base_target(self) -> RigidTransform:
        """Model frame from the body's."""
        return RigidTransform.from_components(self.one["p"][0], Rotation.from_matrix(self.one["R"][0]))


class OutsidePenalty(NamedTuple):
    """Penalty per metre outside the map, how many of the first hypotheses are exempt from it, and the most (nats).

    No more than that is kept of earlier evidence either.
    """

    per_metre: float
    n_free: int
    most: float = np.inf


def evidence(bins: LatestBins, known: KnownMap, penalty: OutsidePenalty) -> tuple[Scalars, Scalars, Scalars]:
    """Evidence of each hypothesis over unrelated fields (nats), its covariance's factor, its misfit beyond that."""
    fit = np.ascontiguousarray(bins.fit)
    found: tuple[Scalars, Scalars, Scalars] = _weigh_all(bins.steps, fit, bins.null, penalty, *known.log_factors)
    return found


@allocating
def _weigh_all(steps, fit, null, penalty, log_factors, log_priors):  # type: ignore[no-untyped-def]
    n_hypotheses, inverse = fit.shape[1], np.exp(-log_factors)
    gained, factor, misfit = np.zeros(n_hypotheses), np.zeros(n_hypotheses), np.zeros(n_hypotheses)
    for k in range(n_hypotheses):
        own, own_det, paid, n = 0.0, 0.0, 0.0, 0.0
        for m in range(len(fit)):
            one, u = fit[m, k], steps[m].u
            if one.is_seen and one.is_known:
                own += one.chi2
                own_det += one.half_log_det
                n += 3.0
            elif one.is_seen and k >= penalty.n_free:
                paid += penalty.per_metre * np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        unrelated = -np.inf
        for c in range(null.shape[1]):
            total, det = 0.0, 0.0
            for m in range(len(fit)):
                if fit[m, k].is_seen and fit[m, k].is_known:
                    total += null[m, c].chi2
                    det += null[m, c].half_log_det
            one_field = _average(total, n, log_factors, inverse, log_priors)[0] - det
            unrelated = np.logaddexp(unrelated, one_field)
        unrelated -= np.log(null.shape[1])
        likelihood, best = _average(own, n, log_factors, inverse, log_priors)
        gained[k] = likelihood - own_det - unrelated - min(paid, penalty.most)
        factor[k] = np.exp(log_factors[best])
        # The covariance's factor is averaged over: what it explains is not to count again.
        misfit[k] = np.sqrt(own / factor[k] / max(n, 1.0))
    return gained, factor, misfit


def forget(bins: LatestBins, known: KnownMap, penalty: OutsidePenalty, bank: np.ndarray) -> None:
    """Move what each hypothesis gained by the first bin to earlier evidence, up to the most unless it is free."""
    gained, rest = (evidence(some, known, penalty)[0] for some in (bins, bins[1:]))
    # A body that may leave the map and is outside forgets nothing, and nothing of that when it comes back.
    is_free, is_outside = np.arange(len(bank)) < penalty.n_free, bins.fit[-1]["is_known"] == 0
    limit = np.where(is_free, np.where(is_outside, np.inf, np.maximum(penalty.most, bank["earlier"])), penalty.most)
    kept = np.minimum(bank["earlier"] + gained - rest, limit)
    # Of one place under several drifts the likeliest is capped, and the others stay as much behind; not more than
    # by these odds, since odometry may come to drift otherwise as seldom as a track is lost.
    free, before = slice(penalty.n_free), (bank["earlier"] + gained - rest)[: penalty.n_free]
    if len(before) > 1:
        kept[free] = kept[int(np.argmax(before))] + np.maximum(before - before.max(), -penalty.most)
    bank["earlier"] = kept


@compiled
def _average(chi2, n, log_factors, inverse, log_priors):  # type: ignore[no-untyped-def]
    """Log-likelihood averaged over the covariance's factor, and the likeliest factor: `PathNoise.factor`."""
    most, best = -np.inf, 0
    for f in range(len(log_factors)):
        found = -0.5 * chi2 * inverse[f] - 0.5 * n * log_factors[f] + log_priors[f]
        if found > most:
            most, best = found, f
    total = 0.0
    for f in range(len(log_factors)):
        found = -0.5 * chi2 * inverse[f] - 0.5 * n * log_factors[f] + log_priors[f] - most
        if found > -30:
            total += np.exp(found)
    return most + np.log(total), best


def weigh(
    bank: np.ndarray, bins: LatestBins, known: KnownMap, penalty: OutsidePenalty, tolerance: tuple[float, float]
) -> list[WeighedHypothesis]:
    """Hypotheses that differ by more than a tolerance (m, rad), most evidence first.

    A pose under several drifts of the odometry is one answer, whose evidence is the sum over these: it includes their
    prior probabilities.
    """
    gained, factor, misfit = evidence(bins, known, penalty)
    gained += bank["earlier"]
    return [
        WeighedHypothesis(
            rows,
            bank[rows[0] : rows[0] + 1],
            float(np.logaddexp.reduce(gained[list(rows)])),
            max(float(misfit[rows[0]]), 1.0) * known.dispersion,
            float(factor[rows[0]]),
        )
        for rows in _distinct(bank, gained, tolerance)
    ]


def _distinct(bank: np.ndarray, gained: Scalars, tolerance: tuple[float, float]) -> list[tuple[int, ...]]:
    """Rows of one answer each, the best first, and of one drift the best only."""
    firsts: list[int] = []
    kept: list[tuple[int, ...]] = []
    most = 1 + 2 * np.cos(tolerance[1])
    for k in np.argsort(-gained, kind="stable").tolist():
        is_near = np.linalg.norm(bank["p"][firsts] - bank["p"][k], axis=1) <= tolerance[0]
        is_near &= (bank["R"][firsts] * bank["R"][k]).sum(axis=(1, 2)) >= most
        if not is_near.any():
            firsts.append(k)
            kept.append((k,))
        elif bank["drift"][k] not in bank["drift"][list(kept[one := int(is_near.argmax())])]:
            kept[one] = (*kept[one], k)
    return kept


def is_doubtful(bins: LatestBins, known: KnownMap, prior_odds: float) -> bool:
    """Whether the first hypothesis, of some odds before, explains bins worse than an unrelated field."""
    gained, _, misfit = evidence(replace(bins, fit=bins.fit[:, :1]), known, OutsidePenalty(0.0, 1))
    return bool(log_odds(float(gained[0]), float(misfit[0]), "log") < -np.log(prior_odds))


def end_of_agreement(bins: LatestBins) -> int:
    """Bin from which on the first hypothesis was worse than the best unrelated field, as the sums have it."""
    fit, unrelated = bins.fit[:, 0], 0.5 * bins.null["chi2"] + bins.null["half_log_det"]
    best = unrelated[:, np.argmin(unrelated.sum(axis=0))]
    gained = (best - 0.5 * fit["chi2"] - fit["half_log_det"]) * (fit["is_known"] & fit["is_seen"])
    return int(np.argmax(np.concatenate([[0.0], np.cumsum(gained)])))


def covariance_of(one: np.ndarray, known: KnownMap, factor: float) -> Covariance6:
    """Give the covariance of xi in ``T Exp(xi)`` of a hypothesis (1,), body's axes, the map's own poses' included."""
    C = np.empty((6, 6))
    # A pose's factor is the root of that of the readings, as odometry's noise is not scaled with them.
    _covariance(one, known.bent, float(np.sqrt(max(factor, 0.0 if known.noise.is_learned else 1.0))), C)
    return C


@compiled
def _covariance(bank, bent, factor, C):  # type: ignore[no-untyped-def]
    """R^T (factor P + bent) R, block by block."""
    R, P = bank[0].R, bank[0].P
    for i in range(0, 6, 3):
        for j in range(0, 6, 3):
            for a in range(3):
                for e in range(3):
                    total = 0.0
                    for m in range(3):
                        for n in range(3):
                            total += R[m, a] * (factor * P[i + m, j + n] + bent[i + m, j + n]) * R[n, e]
                    C[i + a, j + e] = total


def stated(
    one: np.ndarray, last: np.ndarray, T_odom_body: Matrix, known: KnownMap, model: Model, factor: float
) -> np.ndarray:
    """State a hypothesis (1,), once odometry has moved it on (changed) from the last bin, (1,) of STEP."""
    said, moved = np.zeros(1, STATED), np.zeros(1, STEP)
    _state(one, last, moved, T_odom_body, known.up, known.T_map_model, model, said)
    said["covariance"] = covariance_of(one, known, factor)
    return said


@compiled
def _state(bank, last, moved, T, up, T_map_model, model, said):  # type: ignore[no-untyped-def]
    h, step, out = bank[0], last[0], said[0]
    dR, u = moved[0].dR, moved[0].u
    for a in range(3):
        for k in range(3):
            u[a] += step.R[k, a] * (T[k, 3] - step.p[k])
            for e in range(3):
                dR[a, e] += step.R[k, a] * T[k, e]
    predict(h, dR, u, 0.0, up, model)
    out.T[3, 3] = 1.0
    for a in range(3):
        out.bias[a], out.bias_sd[a] = h.b[a], np.sqrt(h.P[BIAS + a, BIAS + a])
        out.T[a, 3] = T_map_model[a, 3]
        for k in range(3):
            out.T[a, 3] += T_map_model[a, k] * h.p[k]
            for e in range(3):
                out.T[a, e] += T_map_model[a, k] * h.R[k, e]
    out.scale, out.gain, out.drift = 1 + h.scale, 1 + h.gain, np.sqrt(h.drift)
