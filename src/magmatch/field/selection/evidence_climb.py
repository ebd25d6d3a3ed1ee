# SPDX-License-Identifier: BSD-3-Clause
"""Coordinate ascent on the evidence, in as few factorisations as possible."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import EvidenceSearch

# A step must gain so many nats, and so many for each independent value: less is chance, and the start is a good one.
# A step to finer splines costs twice as much.
LEAST_GAIN, GAIN, GAIN_OF_FINER, MOST_STEPS = 2.0, 0.005, 0.01, 6
# Factors tried of each number, the second where the first does not help.
DIVERGENCE_WEIGHT_STEPS, LENGTHSCALE_STEPS = (10.0, 0.1), (1.8, 1 / 1.8)
# Longest step of the noise's logarithm, and the reach within which a parabola is as good as the evidence.
LONGEST_STEP, NEAR = 1.6, 0.5
# Bounds of lengthscale over spacing, divergence weight, signal over noise.
RELATIVE_LENGTHSCALES, DIVERGENCE_WEIGHTS, SIGNALS_TO_NOISE = (1.5, 12.0), (3.0, 3001.0), (0.3, 1e5)

# Gives the next point, or None where there is none.
Step = Callable[[Hyperparameters], Hyperparameters | None]


@dataclass(frozen=True, slots=True)
class NoiseOptimum:
    """Numbers that were tried, and the same with the noise that maximises their evidence.

    The evidence was not computed there: the gain (nats) and the maximum-likelihood noise level (T) are extrapolated.
    """

    tried: Hyperparameters
    hyperparameters: Hyperparameters
    gain: float
    noise_sd: float

    @property
    def is_near(self) -> bool:
        """Whether a parabola reaches so far."""
        return bool(abs(np.log(self.hyperparameters.noise_sd / self.tried.noise_sd)) < NEAR)


def climb(search: EvidenceSearch, start: Hyperparameters) -> NoiseOptimum:
    """Noise, divergence weight and lengthscale of the greatest evidence."""
    best = _settled(search, start)
    best = _along(search, best, [partial(_times, "divergence_weight", by) for by in DIVERGENCE_WEIGHT_STEPS])
    return _along(search, best, [partial(_times, "lengthscale", by) for by in LENGTHSCALE_STEPS])


def settle(search: EvidenceSearch, start: Hyperparameters | NoiseOptimum, finer: Step) -> NoiseOptimum:
    """Spacing and noise of the greatest evidence, lengthscale and divergence weight as they are."""
    # First: finer splines make up for a noise that is too large.
    best = start if isinstance(start, NoiseOptimum) else _settled(search, start)
    return _along(search, best, [finer], GAIN_OF_FINER)


def _settled(search: EvidenceSearch, start: Hyperparameters) -> NoiseOptimum:
    """The best noise for the rest of some numbers; raises `numpy.linalg.LinAlgError` where they cannot be used."""
    first = _noise_optimum(search, start)
    return _as_tried(search, start) if first is None else _followed(search, first)


def _followed(search: EvidenceSearch, first: NoiseOptimum) -> NoiseOptimum:
    """Follow Newton's steps, until one is so short that nothing need be computed where it leads."""
    tops = [first]
    while not tops[-1].is_near and len(tops) < MOST_STEPS:
        further = _noise_optimum(search, tops[-1].hyperparameters)
        if further is None:
            break
        tops.append(further)
    # Far from the numbers tried, the parabola is not reliable.
    borne_out = [top if top.is_near else _as_tried(search, top.tried) for top in tops]
    return max(borne_out, key=lambda top: search.log_evidence_of_noise(top.tried) + top.gain)


def _noise_optimum(search: EvidenceSearch, h: Hyperparameters) -> NoiseOptimum | None:
    """Maximum of the parabola in the logarithm of the noise, or a bounded step towards it.

    None where the numbers cannot be used.
    """
    if not np.isfinite(search.log_evidence_of_noise(h)):
        return None
    slopes = search.noise_slopes(h)
    noise_sd = _allowed_noise(h, h.noise_sd * np.exp(_newton_step(*slopes.evidence)))
    step = float(np.log(noise_sd / h.noise_sd))
    gain, level = (first * step + second * step**2 / 2 for first, second in (slopes.evidence, slopes.level))
    return NoiseOptimum(h, replace(h, noise_sd=noise_sd), gain, search.noise_sd(h) * float(np.exp(level)))


def _as_tried(search: EvidenceSearch, h: Hyperparameters) -> NoiseOptimum:
    """Numbers as they were tried; raises `numpy.linalg.LinAlgError` where they cannot be used."""
    return NoiseOptimum(h, h, 0.0, search.noise_sd(h))


def _newton_step(slope: float, bend: float) -> float:
    """Step to the maximum of a parabola, or a bounded step if it has none."""
    step = -slope / bend if bend < 0 else np.copysign(LONGEST_STEP, slope)
    return float(np.clip(step, -LONGEST_STEP, LONGEST_STEP))


def _allowed_noise(h: Hyperparameters, noise_sd: float) -> float:
    """The nearest noise within bounds."""
    low, high = SIGNALS_TO_NOISE
    # A little inside, so that rounding does not put it out of bounds.
    return float(np.clip(noise_sd, h.signal_sd / high * (1 + 1e-9), h.signal_sd / low * (1 - 1e-9)))


def _along(search: EvidenceSearch, start: NoiseOptimum, steps: Sequence[Step], gain: float = GAIN) -> NoiseOptimum:
    """Repeat the first of some steps that helps, as long as it does; each is evaluated at its own best noise."""
    best, least_gain = start, max(LEAST_GAIN, gain * search.n_independent)
    for step in steps:
        for _ in range(MOST_STEPS):
            h = step(best.hyperparameters)
            found = None if h is None else _better(search, h, best, least_gain)
            if found is None:
                break
            best = found
        if best != start:
            break
    return best


def _better(search: EvidenceSearch, h: Hyperparameters, best: NoiseOptimum, least_gain: float) -> NoiseOptimum | None:
    """Numbers with their best noise, if their evidence is higher than the best so far."""
    needed = search.log_evidence(best.tried) + best.gain + least_gain
    found = _noise_optimum(search, h)
    if found is None:
        return None
    # An extrapolated gain is verified; without one, nothing is computed.
    if search.log_evidence(h) + found.gain >= needed and not found.is_near:
        found = _followed(search, found)
    return found if search.log_evidence(found.tried) + found.gain >= needed else None


def _times(name: str, factor: float, h: Hyperparameters) -> Hyperparameters | None:
    """Multiply one hyperparameter by a factor, where that is allowed."""
    other: Hyperparameters = replace(h, **{name: rounded(getattr(h, name) * factor)})
    return other if is_allowed(other) else None


def rounded(value: float) -> float:
    """A number that is the same again after a step there and back, so that nothing is computed twice."""
    return float(f"{value:.10g}")


def is_allowed(h: Hyperparameters) -> bool:
    """Whether numbers are within bounds."""
    return (
        RELATIVE_LENGTHSCALES[0] <= h.lengthscale / h.spacing <= RELATIVE_LENGTHSCALES[1]
        and DIVERGENCE_WEIGHTS[0] <= h.divergence_weight <= DIVERGENCE_WEIGHTS[1]
        and SIGNALS_TO_NOISE[0] <= h.signal_sd / h.noise_sd <= SIGNALS_TO_NOISE[1]
    )
