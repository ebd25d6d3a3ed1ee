# SPDX-License-Identifier: BSD-3-Clause
"""Our field models against an exact Gaussian process, ours and GPyTorch's: time and error at equal numbers.

Usage: PYTHONPATH=tests python benchmarks/bench_field_peers.py
Run with OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1. GPyTorch joins where it is installed. RMSE is of 3-vectors. For
peers on held-out recordings: ``magmatch evaluate mapping``.
"""

import platform
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.inducing_prior import InducingPrior
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel
from magmatch.field.priors import MAX_INDUCING_POINTS, PRIORS
from magmatch.threads import single_threaded
from magmatch_evaluation.script import UT, arguments, rmse_ut, timed
from oracles.dense import DenseGP

HAS_GPYTORCH = find_spec("gpytorch") is not None
BOX = np.array([3.0, 3.0, 1.0])
SD, NOISE_SD = 20 * UT, 0.4 * UT  # of a component of the simulated field; 2 % of it as noise
N_QUERIES, BATCH = 5000, 500
COARSER = 1.5
# Without a constant field.
PUBLISHED = InducingPrior("divergence_free", DIVERGENCE_FREE, DIVERGENCE_FREE, MAX_INDUCING_POINTS, 0.0)


def simulated(n):
    """Samples in a box with dipoles below, and the truth at queries: no source inside, any prior may be right."""
    rng = np.random.default_rng(0)
    sources, moments = rng.uniform([0, 0, -0.8], [3, 3, -0.4], (12, 3)), rng.normal(size=(12, 3))

    def field(x):
        r = x[:, None] - sources
        d = np.linalg.norm(r, axis=2, keepdims=True)
        return (3 * r * (r * moments).sum(axis=2, keepdims=True) / d**5 - moments / d**3).sum(axis=1)

    points = rng.uniform(0, 1, (n, 3)) * BOX
    clean = field(points)
    unit = SD / clean.std()
    queries = rng.uniform(0.05, 0.95, (N_QUERIES, 3)) * BOX
    return points, clean * unit + NOISE_SD * rng.normal(size=(n, 3)), queries, field(queries) * unit


def infer(prior, h, points, field, queries):
    model = prior.build(points, field, h)
    return model.infer(model.observe(points, field)).evaluate(queries).field


def gpytorch_exact(points, field, queries, lengthscale, signal_sd, noise_sd):
    """GPyTorch's exact GP with the published kernel and given numbers: fit and mean by Cholesky."""
    import gpytorch
    import torch

    class DivergenceFree(gpytorch.kernels.Kernel):
        has_lengthscale = False

        def num_outputs_per_input(self, x1, x2):  # noqa: ARG002
            return 3

        def forward(self, x1, x2, diag=False, **_):
            if diag:
                return torch.full((3 * len(x1),), signal_sd**2, dtype=x1.dtype)
            d = (x1[:, None] - x2[None]) / lengthscale
            square = (d * d).sum(-1)
            blocks = d[..., :, None] * d[..., None, :] + (2 - square)[..., None, None] * torch.eye(3, dtype=d.dtype)
            blocks *= (0.5 * signal_sd**2 * torch.exp(-0.5 * square))[..., None, None]
            return blocks.permute(0, 2, 1, 3).reshape(3 * len(x1), 3 * len(x2))

    class Model(gpytorch.models.ExactGP):
        def __init__(self, x, y, likelihood):
            super().__init__(x, y, likelihood)
            self.mean_module = gpytorch.means.MultitaskMean(gpytorch.means.ZeroMean(), num_tasks=3)
            self.covar_module = DivergenceFree()

        def forward(self, x):
            return gpytorch.distributions.MultitaskMultivariateNormal(self.mean_module(x), self.covar_module(x))

    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(
        3, has_task_noise=False, noise_constraint=gpytorch.constraints.GreaterThan(1e-8)
    ).double()
    likelihood.noise = noise_sd**2
    model = Model(torch.from_numpy(points), torch.from_numpy(field), likelihood).double().eval()
    exactly = gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False)
    with torch.no_grad(), exactly, gpytorch.settings.skip_posterior_variances(True):
        return torch.cat([model(chunk).mean for chunk in torch.from_numpy(queries).split(BATCH)]).numpy()


def contenders(points, field, queries, length, signal):
    """Each way of getting the mean at the queries from the samples with numbers fixed beforehand."""
    kernel = Kernel(DIVERGENCE_FREE, length, signal)
    published, spline = PUBLISHED, PRIORS["spline"]
    h = Hyperparameters(length, signal, NOISE_SD, 0.7 * length)
    chosen = spline.choose_hyperparameters(points, field)

    def dense():
        exact = DenseGP.fit(kernel, points, field, NOISE_SD)
        return np.concatenate([exact.mean(part).field for part in np.array_split(queries, 10)])

    runs = {"dense oracle": dense}
    if HAS_GPYTORCH:
        unit = field.std()
        numbers = (length, signal / unit, NOISE_SD / unit)
        runs["GPyTorch exact"] = lambda: unit * gpytorch_exact(points, field / unit, queries, *numbers)
    runs["divergence_free, sparse"] = lambda: infer(published, h, points, field, queries)
    runs["spline (default)"] = lambda: infer(spline, chosen, points, field, queries)
    coarse = replace(chosen, spacing=COARSER * chosen.spacing)
    runs[f"spline, knots {COARSER:g} times as far apart"] = lambda: infer(spline, coarse, points, field, queries)
    return dict(reversed(runs.items()))


@single_threaded
def main():
    """Print fit and mean at 5,000 points with fixed numbers, one thread each."""
    arguments(__doc__)
    packages = ("numpy", "scipy", "numba", *(("torch", "gpytorch") if HAS_GPYTORCH else ()))
    print(f"Python {platform.python_version()}, " + ", ".join(f"{name} {version(name)}" for name in packages))
    if HAS_GPYTORCH:
        import torch

        torch.set_num_threads(1)
    else:
        print("GPyTorch is not installed: its rows are missing.")
    print("| samples | kernel's lengthscale | method | processor s | clock s | RMSE, uT | times GPyTorch's speed |")
    print("|---|---|---|---|---|---|---|")
    for n in (1000, 2000):
        points, field, queries, truth = simulated(n)
        likely = PUBLISHED.choose_hyperparameters(points, field)
        same = (0.3, np.sqrt(2) * SD)
        for label, numbers in (("0.3 m", same), ("likeliest", (likely.lengthscale, likely.signal_sd))):
            lines = {}
            for name, run in contenders(points, field, queries, *numbers).items():
                if name != "GPyTorch exact" and "dense" not in name:
                    run()  # compiles and reads the disk; the slow ones have no need of it
                mean, clock, processor = timed(run)
                lines[name] = processor, clock, rmse_ut(mean, truth)
            peer = lines.get("GPyTorch exact")
            for name, (processor, clock, error) in reversed(lines.items()):
                ratio = f"{peer[0] / processor:.1f}" if peer else "-"
                shown = label if label == "0.3 m" else f"{numbers[0]:.2f} m, likeliest"
                print(
                    f"| {n} | {shown} | {name} | {processor:.3f} | {clock:.3f} | {error:.3f} | {ratio} |", flush=True
                )


if __name__ == "__main__":
    main()
