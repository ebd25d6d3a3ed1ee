# SPDX-License-Identifier: BSD-3-Clause
"""The published field model: what the spacing of its inducing points costs, against the exact posterior.

Run: PYTHONPATH=tests python benchmarks/bench_divergence_free.py

Error at left-out stretches of a simulated office (noise included), on the same 1,500 samples; needs the extra
'simulation'.
"""

from dataclasses import replace

import numpy as np

from magmatch import simulate
from magmatch.field.config import FieldConfig
from magmatch.field.inducing.inducing_prior import InducingConfig
from magmatch.field.inducing.kernels import DivergenceFreeKernel
from magmatch.field.prior_choice.numbers import choose_numbers
from magmatch.field.priors.divergence_free import DivergenceFreePrior
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.script import rmse_ut
from oracles.dense import DenseGP

CONSTANT_SD = InducingConfig().constant_sd
SPACINGS = ((0.6, 0.8), (0.7, 0.7), (0.7, 1.0), (0.85, 1.0), (0.85, 1.4), (1.0, 1.4))


def main() -> None:
    """Print the table."""
    survey = simulate("office", seed=0, config=SimulationConfig(n_samples=2500)).base
    samples = survey.transformed(survey.principal_frame().inv())
    is_test = (np.arange(len(samples)) // 25) % 6 == 2
    train, test = samples.subset(np.flatnonzero(~is_test)[:1500]), samples.subset(is_test)
    h = choose_numbers(DivergenceFreePrior(), train, FieldConfig())
    kernel = DivergenceFreeKernel(h.lengthscale, h.signal_sd)
    print(f"{len(train)} samples, error at {len(test)} left out (noise included)")
    for label, constant_sd in (("exact", CONSTANT_SD), ("exact, no constant field", 0.0)):
        exact = DenseGP.fit(kernel, train.positions, train.field, h.noise_sd, constant_sd)
        print(f"  {label}: {rmse_ut(exact.mean(test.positions).field, test.field):.3f} uT")
    for spacing, reach in SPACINGS:
        prior = DivergenceFreePrior(InducingConfig(spacing_ratio=spacing, reach_ratio=reach))
        model = prior.build(train.positions, train.field, replace(h, spacing=spacing * h.lengthscale))
        posterior = model.infer(model.observe(train.positions, train.field))
        rmse = rmse_ut(posterior.evaluate(test.positions).field, test.field)
        print(f"  spacing {spacing} l, reach {reach} l: {rmse:.3f} uT, {len(model.basis.grid)} inducing points")


if __name__ == "__main__":
    main()
