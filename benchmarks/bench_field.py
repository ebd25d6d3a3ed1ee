# SPDX-License-Identifier: BSD-3-Clause
"""Accuracy, calibration and time of the default field model; OPENBLAS_NUM_THREADS=1 gives the one-thread figures.

Usage: python benchmarks/bench_field.py [--from DIR] [--quick] [--repeat 3]
Simulated rooms and tables have exact truth; the walk is walk one of CEA predicting walk two. Times are seconds of the
processor, the least of the repetitions: choosing the numbers, fit, field and gradient at the queries, their sd.
"""

import numpy as np

from magmatch.data.recordings import load_recordings
from magmatch.field.priors import PRIORS
from magmatch.field.spline.spline_model import SplineModel
from magmatch.threads import single_threaded
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import UT, arguments, rmse_ut, timed

COLUMNS = ("case", "RMSE, uT", "95 % interval covers", "numbers / fit / field / sd, s", "together, s")


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


def room(seed, n=2500):
    """Samples anywhere in a box."""
    rng, size = np.random.default_rng(seed), (3.0, 3.0, 0.6)
    sources = sources_around(rng, size)
    x, q = rng.uniform(0, size, (n, 3)), rng.uniform(0, size, (4000, 3))
    b = dipole_field(x, *sources) + 0.3 * UT * rng.normal(size=x.shape)
    return x, b, {"between": (q, dipole_field(q, *sources))}


def lanes(seed, n):
    """A sensor carried to and fro in lanes 40 cm apart, at three heights 40 cm apart."""
    rng = np.random.default_rng(seed)
    sources = sources_around(rng, (4.0, 4.0, 1.2))
    along, lines = np.linspace(0.2, 3.8, n // 30), []
    for z in (0.3, 0.7, 1.1):
        for i, y in enumerate(np.linspace(0.2, 3.8, 10)):
            lines.append(np.c_[along[:: 1 - 2 * (i % 2)], np.full(len(along), y), np.full(len(along), z)])
    x = np.concatenate(lines)
    x += 0.01 * rng.normal(size=x.shape)
    b = dipole_field(x, *sources) + 0.3 * UT * rng.normal(size=x.shape)
    q = rng.uniform([0.2, 0.2, 0.3], [3.8, 3.8, 1.1], (4000, 3))
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


def walk(walks, training, test):
    """One walk through a building, and another to predict."""
    T = walks[training].principal_frame().inv()
    base, other = walks[training].transformed(T), walks[test].transformed(T)
    return base.positions, base.field, {"other walk": (other.positions, other.field)}


def fitted(x, b, q):
    """Numbers, model and posterior, and the processor time of each step."""
    prior = PRIORS["spline"]
    h, _, choosing = timed(prior.choose_hyperparameters, x, b)
    model, _, building = timed(prior.build, x, b, h)
    posterior, _, fitting = timed(model.fit, x, b, {}, None)
    asking = [timed(ask, q, 1).processor for ask in (posterior.evaluate, posterior.covariance)]
    return h, model, posterior, np.array([choosing, building + fitting, *asking])


def measure(name, scenario, has_truth=True, repeat=1):
    x, b, tests = scenario
    q = next(iter(tests.values()))[0]
    rounds = [fitted(x, b, q) for _ in range(repeat)]
    h, model, posterior, _ = rounds[0]
    times = np.min([seconds for *_, seconds in rounds], axis=0)
    size = f"{model.cells.n_nodes} nodes" if isinstance(model, SplineModel) else f"{len(model.tiles)} tiles"
    print(f"{name}: {len(x)} samples, {size} at {h.spacing:.3f} m; lengthscale {h.lengthscale:.2f} m,")
    print(f"    noise {h.noise_sd / UT:.2f} uT, inflation {h.inflation:.1f}")
    seconds, rows = [" / ".join(f"{s:.2f}" for s in times), f"{times.sum():.2f}"], []
    for label, (points, truth) in tests.items():
        field = posterior.evaluate(points).field
        variance = np.diagonal(posterior.covariance(points), axis1=1, axis2=2)
        sd = np.sqrt(variance if has_truth else variance + h.noise_sd**2)
        rmse, cover = rmse_ut(field, truth), np.mean(abs(field - truth) < 1.96 * sd)
        rows.append([f"{name}, {len(x):,} samples: {label}", f"{rmse:.3f}", f"{cover:.1%}", *seconds])
        print(*rows[-1], flush=True)
    return rows


@single_threaded
def main():
    asked = arguments(__doc__, recordings=None, quick=False, repeat=3, save=saver)
    # Compiles, or loads what was compiled.
    for scenario in (room(99, 400), lanes(99, 900)):
        fitted(*scenario[:2], scenario[0])
    few = range(1 if asked.quick else 4)
    cases = [(f"room {seed}", room(seed)) for seed in few]
    cases += [("room", room(4, 3000))]
    cases += [(f"room {seed}", room(10 + seed, n)) for n in (300, 1000) for seed in few]
    cases += [(f"lanes {seed}", lanes(seed, n)) for n in (400, 1000, 3000) for seed in few]
    cases += [("plane", plane(1)), *((f"table {seed}", table(seed)) for seed in few[:2])]
    rows = [row for name, case in cases for row in measure(name, case, repeat=asked.repeat)]
    if asked.recordings and not asked.quick:
        walks = load_recordings("cea", asked.recordings)
        for name, order in (("building", ("training", "test")), ("building, reversed", ("test", "training"))):
            rows += measure(name, walk(walks, *order), has_truth=False, repeat=asked.repeat)
    show(COLUMNS, rows, asked.save)


if __name__ == "__main__":
    main()
