# SPDX-License-Identifier: BSD-3-Clause
"""Our field models against what one would use instead: time at equal numbers, and error on held-out recordings.

Usage: PYTHONPATH=tests python benchmarks/bench_field_peers.py [--from DIR] [--skip-times] [--rows cea ...]
Run with OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1. GPyTorch joins where it is installed. RMSE is of 3-vectors; every
method chooses its numbers from the training samples alone. 'near' are queries less than 2 m from a training sample,
'far' those of them more than 0.3 m from any.
"""

import platform
from dataclasses import replace
from importlib.metadata import version

import numpy as np
from bench_priors import left_out
from field_peers import HAS_GPYTORCH, PEERS, exact_divergence_free
from scipy.spatial import cKDTree

from magmatch import FieldConfig, build_map
from magmatch.data.recordings import load_recordings
from magmatch.errors import MagmatchError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.inducing_prior import InducingConfig
from magmatch.field.inducing.kernels import DivergenceFreeKernel
from magmatch.field.priors import PRIORS
from magmatch.field.priors.divergence_free import DivergenceFreePrior
from magmatch.threads import single_threaded
from magmatch_evaluation.script import UT, arguments, rmse_ut, timed
from oracles.dense import DenseGP

BOX = np.array([3.0, 3.0, 1.0])
SD, NOISE_SD = 20 * UT, 0.4 * UT  # of a component of the simulated field; 2 % of it as noise
FAR = (0.3, 2.0)
COARSER = 1.5
OURS = {"divergence_free (published)": "divergence_free", "spline (default)": "spline", "auto": "auto"}


def simulated(n, n_queries=5000):
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
    queries = rng.uniform(0.05, 0.95, (n_queries, 3)) * BOX
    return points, clean * unit + NOISE_SD * rng.normal(size=(n, 3)), queries, field(queries) * unit


def infer(prior, h, points, field, queries):
    model = prior.build(points, field, h)
    return model.infer(model.observe(points, field)).evaluate(queries).field


def contenders(points, field, queries, length, signal):
    """Each way of getting the mean at the queries from the samples with numbers fixed beforehand."""
    kernel = DivergenceFreeKernel(length, signal)
    published, spline = DivergenceFreePrior(InducingConfig(constant_sd=0.0)), PRIORS["spline"]
    h = Hyperparameters(length, signal, NOISE_SD, 0.7 * length)
    chosen = spline.choose_hyperparameters(points, field)

    def dense():
        exact = DenseGP.fit(kernel, points, field, NOISE_SD)
        return np.concatenate([exact.mean(part).field for part in np.array_split(queries, 10)])

    runs = {"dense oracle": dense}
    if HAS_GPYTORCH:
        unit = field.std()
        numbers = (length, signal / unit, NOISE_SD / unit)
        runs["GPyTorch exact"] = lambda: unit * exact_divergence_free(points, field / unit, queries, *numbers)
    runs["divergence_free, sparse"] = lambda: infer(published, h, points, field, queries)
    runs["spline (default)"] = lambda: infer(spline, chosen, points, field, queries)
    coarse = replace(chosen, spacing=COARSER * chosen.spacing)
    runs[f"spline, knots {COARSER:g} times as far apart"] = lambda: infer(spline, coarse, points, field, queries)
    return dict(reversed(runs.items()))


@single_threaded
def compare_times():
    """Print fit and mean at 5,000 points with fixed numbers, one thread each."""
    print("| samples | kernel's lengthscale | method | processor s | clock s | RMSE, uT | times GPyTorch's speed |")
    print("|---|---|---|---|---|---|---|")
    for n in (1000, 2000):
        points, field, queries, truth = simulated(n)
        likely = DivergenceFreePrior(InducingConfig(constant_sd=0.0)).choose_hyperparameters(points, field)
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


def recordings(data):
    """Name, training survey, query points and field there."""
    cea, aalto = load_recordings("cea", data), load_recordings("aalto", data)
    for name, first, second in (("cea 1-2", "training", "test"), ("cea 2-1", "test", "training")):
        yield name, cea[first], cea[second].positions, cea[second].field
    jidling = load_recordings("jidling", data)["volume"]
    surveys = {"jidling": jidling.subset(np.arange(0, len(jidling), -(-len(jidling) // 6000)))}
    surveys |= {f"kok {name}": survey for name, survey in load_recordings("kok", data).items()}
    for name, survey in surveys.items():
        case = left_out(name, survey, 10)
        points, field, _ = case.tests["left out"]
        yield name, case.survey, points, field
    pair = aalto["invensense-1"].merged(aalto["invensense-2"])
    yield "aalto 1+2-4", pair, aalto["invensense-4"].positions, aalto["invensense-4"].field


def predict(name, survey, queries):
    """Field at queries, and its standard deviation with noise where the method is ours."""
    if name in PEERS:
        return PEERS[name](survey.positions, survey.field, queries), None, ""
    field_map = build_map(survey, FieldConfig(prior=OURS[name]))
    covariance = field_map.covariance(queries)
    variance = np.diagonal(covariance, axis1=1, axis2=2) + field_map.hyperparameters.noise_sd**2
    taken = f" ({field_map.config.prior})" if name == "auto" else ""
    return field_map.evaluate(queries).field, np.sqrt(variance), taken


@single_threaded
def compare_errors(data, rows, skipped):
    """Print errors on held-out recordings."""
    print(
        "| case | method | RMSE, uT | near, uT | far, uT | 95 % covers | processor s |\n|---|---|---|---|---|---|---|"
    )
    for case, survey, queries, truth in recordings(data):
        if rows and not case.startswith(tuple(rows)):
            continue
        away = cKDTree(survey.positions).query(queries)[0]
        far = (away > FAR[0]) & (away < FAR[1])
        near = away < FAR[1]
        print(f"| **{case}** | {len(survey)} samples | {len(queries)} queries | {near.sum()} | {far.sum()} | | |")
        for name in (name for name in (*PEERS, *OURS) if name not in skipped):
            try:
                (mean, sd, note), _, seconds = timed(predict, name, survey, queries)
            except (MagmatchError, ValueError, np.linalg.LinAlgError) as error:
                print(f"| {case} | {name} | - | - | - | - | {error} |", flush=True)
                continue
            cover = "-" if sd is None else f"{np.mean(np.abs(mean - truth) < 1.96 * sd):.1%}"
            kinds = (np.isfinite(away), near, far)
            errors = [f"{rmse_ut(mean[rows], truth[rows]):.2f}" if rows.sum() >= 20 else "-" for rows in kinds]
            print(f"| {case} | {name}{note} | {' | '.join(errors)} | {cover} | {seconds:.1f} |", flush=True)


def main():
    asked = arguments(__doc__, recordings=None, rows=[], skip=[], skip_times=False)
    packages = ("numpy", "scipy", "numba", *(("torch", "gpytorch") if HAS_GPYTORCH else ()))
    print(f"Python {platform.python_version()}, " + ", ".join(f"{name} {version(name)}" for name in packages))
    if HAS_GPYTORCH:
        import torch

        torch.set_num_threads(1)
    else:
        print("GPyTorch is not installed: its rows are missing.")
    if not asked.skip_times:
        compare_times()
    if asked.recordings:
        compare_errors(asked.recordings, asked.rows, asked.skip)


if __name__ == "__main__":
    main()
