# SPDX-License-Identifier: BSD-3-Clause
"""How probable each hypothesis is after a stretch of path: the evidence and the decision of a registration."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.compiled import compiled
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import Fit
from magmatch.localization.state import PLACE, Bank
from magmatch.registration.decide.posterior import log_odds
from magmatch.registration.weigh.hypothesis import Kind
from magmatch.typing import Covariance6, Indices, Scalars, Vector3


@dataclass(frozen=True, eq=False, slots=True)
class Crowd:
    """Hypotheses with how they fared in the last bins (k, n), which bins they have seen, and what they bring along.

    Attributes
    ----------
    earlier : (k,) array, nats
        What the search for each cost, and what older bins gained since.
    """

    bank: Bank
    fit: Fit
    is_seen: np.ndarray
    earlier: Scalars

    def __len__(self) -> int:
        return len(self.earlier)

    @classmethod
    def none(cls, n_bins: int = 0) -> "Crowd":
        """No hypothesis."""
        return cls(Bank.empty(0), Fit.empty(0, n_bins), np.zeros((0, n_bins), dtype=np.bool_), np.zeros(0))

    def rows(self, chosen: Indices) -> "Crowd":
        """Copies of some."""
        return Crowd(
            self.bank.rows(chosen), self.fit.rows(chosen), self.is_seen[chosen].copy(), self.earlier[chosen].copy()
        )

    def joined(self, other: "Crowd") -> "Crowd":
        """These, then others."""
        seen, earlier = (np.concatenate([getattr(c, name) for c in (self, other)]) for name in ("is_seen", "earlier"))
        return Crowd(self.bank.joined(other.bank), self.fit.joined(other.fit), seen, earlier)

    def after(self, new: Fit) -> "Crowd":
        """With one more bin."""
        seen = np.ones((len(self), 1), dtype=np.bool_)
        return Crowd(self.bank, self.fit.then(new), np.concatenate([self.is_seen, seen], axis=1), self.earlier)

    def without_first(self, gained: Scalars, most: Scalars) -> "Crowd":
        """The first bin forgotten, but for what each gained by it, up to a sum."""
        earlier = np.minimum(self.earlier + gained, np.maximum(most, self.earlier))
        return Crowd(self.bank, self.fit.columns(slice(1, None)), self.is_seen[:, 1:], earlier)


@dataclass(frozen=True, eq=False, slots=True)
class Weighed:
    """One hypothesis as a decision sees it; see `magmatch.registration.weigh.hypothesis`."""

    row: int
    bank: Bank
    covariance: Covariance6
    log_evidence: float
    misfit: float
    factor: float
    overlap: float
    center: Vector3
    kind: Kind = "walk"

    @property
    def T_base_target(self) -> RigidTransform:
        """Model frame from the body's."""
        return pose_of(self.bank, self.row)

    @property
    def attainable(self) -> float:
        """Not asked for."""
        return self.log_evidence


def evidence(
    crowd: Crowd, null: Fit, known: KnownMap, price: Scalars, since: int
) -> tuple[Scalars, Scalars, Scalars]:
    """Evidence of each hypothesis over an unrelated field (nats), normalised misfit, and factor on its covariance.

    Parameters
    ----------
    crowd : Crowd
    null : Fit
        Of unrelated fields, over the same bins.
    known : KnownMap
    price : (k, n) array, nats
        What each bin outside the map costs each hypothesis.
    since : int
        First bin that counts.
    """
    n = len(crowd)
    gained, misfit, factor = np.zeros(n), np.zeros(n), np.ones(n)
    _weigh_all(
        crowd.fit.chi2, crowd.fit.half_log_det, crowd.fit.is_known, crowd.is_seen, price, since,
        null.chi2, null.half_log_det, *known.noise.log_factors(), gained, misfit, factor,
    )  # fmt: skip
    return gained, misfit, factor


@compiled
def _weigh_all(  # type: ignore[no-untyped-def]
    chi2, half_log_det, is_known, is_seen, price, since, null_chi2, null_half_log_det, log_factors, log_priors,
    gained, misfit, factor,
):  # fmt: skip
    inverse = np.exp(-log_factors)
    for k in range(len(chi2)):
        own, own_det, paid, n = 0.0, 0.0, 0.0, 0
        for m in range(since, chi2.shape[1]):
            if is_seen[k, m] and is_known[k, m]:
                own += chi2[k, m]
                own_det += half_log_det[k, m]
                n += 3
            elif is_seen[k, m]:
                paid += price[k, m]
        unrelated = -np.inf
        for c in range(len(null_chi2)):
            total, det = 0.0, 0.0
            for m in range(since, chi2.shape[1]):
                if is_seen[k, m] and is_known[k, m]:
                    total += null_chi2[c, m]
                    det += null_half_log_det[c, m]
            unrelated = max(unrelated, _average(total, n, log_factors, inverse, log_priors)[0] - det)
        likelihood, best = _average(own, n, log_factors, inverse, log_priors)
        gained[k] = likelihood - own_det - unrelated - paid
        misfit[k] = np.sqrt(own / max(n, 1))
        factor[k] = np.exp(log_factors[best])


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
    crowd: Crowd, null: Fit, known: KnownMap, price: Scalars, since: int, tolerance: tuple[float, float]
) -> list[Weighed]:
    """Hypotheses that differ by more than a tolerance (m, rad), most evidence first; the arguments of `evidence`."""
    gained, misfit, factor = evidence(crowd, null, known, price, since)
    gained = gained + crowd.earlier
    overlap = (crowd.fit.is_known & crowd.is_seen).sum(axis=1) / np.maximum(crowd.is_seen.sum(axis=1), 1)
    return [
        Weighed(
            k, crowd.bank, covariance_of(crowd.bank, k, known, factor[k]), float(gained[k]), float(misfit[k]),
            float(factor[k]), float(overlap[k]), np.zeros(3),
        )
        for k in _distinct(crowd.bank, gained, tolerance)
    ]  # fmt: skip


def _distinct(bank: Bank, gained: Scalars, tolerance: tuple[float, float]) -> list[int]:
    """Hypotheses no two of which are one answer, the best of each."""
    kept: list[int] = []
    most = 1 + 2 * np.cos(tolerance[1])
    for k in np.argsort(-gained, kind="stable"):
        is_near = np.linalg.norm(bank.p[kept] - bank.p[k], axis=1) <= tolerance[0]
        if not (is_near & ((bank.R[kept] * bank.R[k]).sum(axis=(1, 2)) >= most)).any():
            kept.append(int(k))
    return kept


def is_doubtful(crowd: Crowd, null: Fit, known: KnownMap, recent: int, prior_odds: float) -> bool:
    """Whether the latest bins of the first hypothesis, of some odds before, look more like an unrelated field."""
    one = crowd.rows(np.array([0]))
    gained, misfit, _ = evidence(one, null, known, np.zeros_like(one.fit.chi2), max(null.chi2.shape[1] - recent, 0))
    return bool(log_odds(float(gained[0]), float(misfit[0]), "walk") < -np.log(prior_odds))


def gains(crowd: Crowd, null: Fit, bins: slice) -> np.ndarray:
    """What each hypothesis gained in some bins over the unrelated field that is the likeliest there, (k, bins)."""
    unrelated = 0.5 * null.chi2[:, bins] + null.half_log_det[:, bins]
    best = unrelated[np.argmin(unrelated.sum(axis=1))]
    gained = best - 0.5 * crowd.fit.chi2[:, bins] - crowd.fit.half_log_det[:, bins]
    return np.asarray(gained * (crowd.fit.is_known[:, bins] & crowd.is_seen[:, bins]))


def end_of_agreement(crowd: Crowd, null: Fit, recent: int) -> int:
    """Bin from which on the first hypothesis was worse than the best unrelated field, as the sums have it."""
    first = max(null.chi2.shape[1] - recent, 0)
    sums = np.concatenate([[0.0], np.cumsum(gains(crowd, null, slice(first, None))[0])])
    return int(first + np.argmax(sums))


def pose_of(bank: Bank, k: int) -> RigidTransform:
    """Model frame from the body's."""
    return RigidTransform.from_components(bank.p[k], Rotation.from_matrix(bank.R[k]))


def covariance_of(bank: Bank, k: int, known: KnownMap, factor: float) -> Covariance6:
    """Of xi in ``T Exp(xi)``, body's axes; how the map's own poses may be off is part of it."""
    least = 0.0 if known.noise.is_learned else 1.0
    C = max(factor, least) * bank.P[k, : PLACE + 3, : PLACE + 3]
    C = C + np.diag(np.repeat([known.noise.attitude_sd**2, known.noise.drift_sd**2], 3))
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = bank.R[k]
    return np.asarray(turn.T @ C @ turn)
