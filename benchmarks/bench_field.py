# SPDX-License-Identifier: BSD-3-Clause
"""Accuracy, calibration and time of the default field model; OPENBLAS_NUM_THREADS=1 gives the one-thread figures.

Usage: python benchmarks/bench_field.py [--data ../shared/data] [--quick]
Simulated rooms and tables have exact truth; the walk is walk one of CEA predicting walk two.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.priors import PRIORS

UT = 1e-6


def dipole_field(x, position, moment):
    """Field (T) of dipoles with moments in T m^3."""
    out = np.zeros_like(x)
    for p, m in zip(position, moment, strict=True):
        r = x - p
        d = np.linalg.norm(r, axis=1, keepdims=True)
        out += 3 * (r @ m)[:, None] * r / d**5 - m / d**3
    return out + np.array([18.0, 3.0, -45.0]) * UT


def sources_around(rng, size):
    """60 dipoles at least 35 cm outside of a box."""
    position, high = [], np.array(size)
    while len(position) < 60:
        p = rng.uniform([-1, -1, -1], [high[0] + 1, high[1] + 1, high[2] + 1.6])
        if np.linalg.norm(p - np.clip(p, 0, high)) > 0.35:
            position.append(p)
    return np.array(position), rng.normal(size=(60, 3)) * rng.lognormal(0, 0.7, size=(60, 1)) * 2.5 * UT


def room(seed, n=2500, noise=0.3, size=(3.0, 3.0, 0.6)):
    """Samples anywhere in a box."""
    rng = np.random.default_rng(seed)
    sources = sources_around(rng, size)
    x, q = rng.uniform(0, size, (n, 3)), rng.uniform(0, size, (4000, 3))
    b = dipole_field(x, *sources) + noise * UT * rng.normal(size=x.shape)
    return x, b, {"between": (q, dipole_field(q, *sources))}


def plane(seed):
    """Samples at one height; truth above it."""
    rng = np.random.default_rng(seed)
    sources = sources_around(rng, (3.0, 3.0, 0.6))
    x = np.c_[rng.uniform(0, 3, (1500, 2)), 0.3 + 0.005 * rng.normal(size=1500)]
    b = dipole_field(x, *sources) + 0.3 * UT * rng.normal(size=x.shape)
    tests = {}
    for above in (0.05, 0.1, 0.2):
        q = np.c_[rng.uniform(0.1, 2.9, (1500, 2)), np.full(1500, 0.3 + above)]
        tests[f"{100 * above:.0f} cm above"] = (q, dipole_field(q, *sources))
    return x, b, tests


def table(seed):
    """A sensor 5 cm above a table in lines 5 cm apart, magnets 5 to 12 cm under it."""
    rng = np.random.default_rng(seed)
    sources = np.c_[rng.uniform(0, [1.2, 0.8], (8, 2)), rng.uniform(-0.12, -0.05, 8)]
    moment = rng.normal(size=(8, 3))
    moment *= 0.03 * UT / np.linalg.norm(moment, axis=1, keepdims=True)
    s, y = np.meshgrid(np.arange(0, 1.2, 0.01), np.arange(0, 0.81, 0.05))
    x = np.stack([s.ravel(), y.ravel(), np.full(s.size, 0.05)], axis=1)
    b = dipole_field(x, sources, moment) + 0.3 * UT * rng.normal(size=x.shape)
    q = np.c_[rng.uniform(0.03, 0.77, (1500, 2)), np.full(1500, 0.05)]
    return x, b, {"between": (q, dipole_field(q, sources, moment))}


def walk(folder, reverse=False):
    """Walk one of a building, and walk two to predict."""
    files = ["corridor_training.csv", "corridor_test.csv"][:: -1 if reverse else 1]
    one, two = (np.loadtxt(folder / "cea" / name, delimiter=",") for name in files)
    survey = Survey(one[:, :3], one[:, 3:] * UT)
    T = survey.principal_frame().inv()
    base, other = survey.transformed(T), Survey(two[:, :3], two[:, 3:] * UT).transformed(T)
    return base.positions, base.field, {"other walk": (other.positions, other.field)}


def measure(name, scenario, has_truth=True):
    x, b, tests = scenario
    prior, clock = PRIORS["spline"], time.perf_counter
    t = [clock()]
    h = prior.choose_hyperparameters(x, b)
    t.append(clock())
    model = prior.build(x, b, h)
    posterior = model.infer(model.observe(x, b))
    t.append(clock())
    q = next(iter(tests.values()))[0]
    posterior.evaluate(q, 1)
    t.append(clock())
    posterior.covariance(q, 1)
    t.append(clock())
    steps = " ".join(f"{s} {d:.2f}" for s, d in zip(("hyper", "fit", "eval", "sd"), np.diff(t), strict=True))
    print(f"{name}: {len(x)} samples, {model.cells.n_nodes} nodes at {h.spacing:.3f} m")
    print(f"    lengthscale {h.lengthscale:.2f} m, noise {h.noise_sd / UT:.2f} uT, inflation {h.inflation:.1f}")
    print(f"    {steps}, total {t[-1] - t[0]:.2f} s")
    for label, (points, truth) in tests.items():
        error = posterior.evaluate(points).field - truth
        variance = np.diagonal(posterior.covariance(points), axis1=1, axis2=2)
        sd = np.sqrt(variance if has_truth else variance + h.noise_sd**2)
        rmse = np.sqrt((error**2).sum(axis=1).mean()) / UT
        cover = np.mean(abs(error) < 1.96 * sd)
        print(f"    {label}: RMSE {rmse:.3f} uT (3-vectors), 95 % intervals cover {cover:.1%}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[1] / "../shared/data")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    measure("warm-up (compiles)", room(99, 400))
    for seed in range(1 if arguments.quick else 4):
        measure(f"room {seed}", room(seed))
    measure("room, 3,000 samples", room(4, 3000))
    measure("plane", plane(1))
    for seed in range(1 if arguments.quick else 2):
        measure(f"table {seed}", table(seed))
    if (arguments.data / "cea").exists() and not arguments.quick:
        measure("building", walk(arguments.data), has_truth=False)
        measure("building, reversed", walk(arguments.data, reverse=True), has_truth=False)


if __name__ == "__main__":
    main()
