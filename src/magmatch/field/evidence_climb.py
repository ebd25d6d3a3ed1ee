# SPDX-License-Identifier: BSD-3-Clause
"""Uphill in the evidence, one number after the other, in as few factorisations as will do."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline_evidence import EvidenceSearch

# A step must gain so many nats: less is chance, and the start is a good one.
LEAST_GAIN, MOST_STEPS = 2.0, 6
# Factors tried of each number, the second where the first does not help. Less noise comes first, since the start has
# more than most.
COARSE_NOISE, FINE_NOISE, STIFFNESS, LENGTHSCALE = (1 / 3.0, 3.0), (0.5, 2.0), (10.0, 0.1), (1.8, 1 / 1.8)
# Bounds of lengthscale over spacing, stiffness, signal over noise.
RELATIVE_LENGTHSCALES, STIFFNESSES, SIGNALS_TO_NOISE = (1.5, 12.0), (3.0, 3001.0), (0.3, 1e5)

# Gives the next point, or None where there is none.
Step = Callable[[Hyperparameters], Hyperparameters | None]
Measure = Callable[[Hyperparameters], float]


def climb(search: EvidenceSearch, start: Hyperparameters) -> Hyperparameters:
    """Noise, stiffness and lengthscale of the greatest evidence.

    Parameters
    ----------
    search : EvidenceSearch
    start : Hyperparameters

    Returns
    -------
    Hyperparameters
        To within a step of each number; the noise where a parabola through its steps is highest.
    """
    measure = search.log_evidence
    first = _along(measure, start, _steps("noise_sd", COARSE_NOISE))
    best = _along(measure, first, _steps("stiffness", STIFFNESS))
    best = _along(measure, best, _steps("lengthscale", LENGTHSCALE))
    if best != first:
        best = _along(measure, best, _steps("noise_sd", COARSE_NOISE))
    return _highest_between(measure, best, COARSE_NOISE)


def settle(
    search: EvidenceSearch, start: Hyperparameters, finer: Step, is_settled: bool
) -> tuple[Hyperparameters, float]:
    """Spacing and noise of the greatest evidence, lengthscale and stiffness as they are.

    Parameters
    ----------
    search : EvidenceSearch
    start : Hyperparameters
    finer : callable
        Gives the next spacing, None where there is none: spacings only shrink, since coarser splines can but hide
        what finer ones show.
    is_settled : bool
        Whether the noise was found by the same search.

    Returns
    -------
    hyperparameters : Hyperparameters
    noise_sd : float, T
        Level of the greatest likelihood there.
    """
    best, noise_sd = (start, search.noise_sd(start)) if is_settled else _settled_noise(search, start)
    # Not before: finer splines make up for a noise that is too large.
    closer = _along(search.log_evidence, best, [finer]) if finer(best) is not None else best
    return (best, noise_sd) if closer == best else _settled_noise(search, closer)


def _settled_noise(search: EvidenceSearch, start: Hyperparameters) -> tuple[Hyperparameters, float]:
    best = _along(search.log_evidence_of_noise, start, _steps("noise_sd", FINE_NOISE))
    final = _highest_between(search.log_evidence_of_noise, best, FINE_NOISE)
    return final, _noise_between(search, best, final)


def _along(measure: Measure, start: Hyperparameters, steps: Sequence[Step]) -> Hyperparameters:
    """Repeat the first of some steps that helps, as long as it does."""
    best = start
    for step in steps:
        for _ in range(MOST_STEPS):
            h = step(best)
            if h is None or measure(h) < measure(best) + LEAST_GAIN:
                break
            best = h
        if best != start:
            break
    return best


def _steps(name: str, factors: Sequence[float]) -> list[Step]:
    """Multiply a number by each of some factors, as far as is allowed."""

    def times(factor: float) -> Step:
        def step(h: Hyperparameters) -> Hyperparameters | None:
            other: Hyperparameters = replace(h, **{name: rounded(getattr(h, name) * factor)})
            return other if is_allowed(other) else None

        return step

    return [times(factor) for factor in factors]


def rounded(value: float) -> float:
    """A number that is the same again after a step there and back, so that nothing is computed twice."""
    return float(f"{value:.10g}")


def is_allowed(h: Hyperparameters) -> bool:
    """Whether numbers are within bounds."""
    return (
        RELATIVE_LENGTHSCALES[0] <= h.lengthscale / h.spacing <= RELATIVE_LENGTHSCALES[1]
        and STIFFNESSES[0] <= h.stiffness <= STIFFNESSES[1]
        and SIGNALS_TO_NOISE[0] <= h.signal_sd / h.noise_sd <= SIGNALS_TO_NOISE[1]
    )


def _highest_between(measure: Measure, best: Hyperparameters, factors: Sequence[float]) -> Hyperparameters:
    """Where the parabola in the logarithm of the noise is highest, through the best step and both beside it."""
    beside = [step(best) for step in _steps("noise_sd", factors)]
    values = [-np.inf if h is None else measure(h) for h in beside]
    bend = values[0] + values[1] - 2 * measure(best)
    if not (np.isfinite(bend) and bend < 0):
        return best
    share = float(np.clip(0.5 * (values[1] - values[0]) / bend, -0.5, 0.5))
    return replace(best, noise_sd=rounded(best.noise_sd * factors[0] ** share))


def _noise_between(search: EvidenceSearch, best: Hyperparameters, final: Hyperparameters) -> float:
    """Noise level of the greatest likelihood between steps that were computed."""
    if final == best:
        return search.noise_sd(best)
    beside = [h for step in _steps("noise_sd", FINE_NOISE) if (h := step(best)) is not None]
    computed = sorted([best, *beside], key=lambda h: h.noise_sd)
    x, y = (np.log([f(h) for h in computed]) for f in (lambda h: h.noise_sd, search.noise_sd))
    return float(np.exp(np.polyval(np.polyfit(x, y, 2), np.log(final.noise_sd))))
