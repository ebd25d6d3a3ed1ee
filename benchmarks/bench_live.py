# SPDX-License-Identifier: BSD-3-Clause
"""Live estimation along an endless walk, one sample per call, against the published recursive update; one thread.

Usage: OPENBLAS_NUM_THREADS=1 python benchmarks/bench_live.py [--samples 200000] [--block 16]
    [--from DIR]
A robot walks loops through a building at 1 m/s with a 200 Hz sensor, and asks once a second of its own time for
field, gradient and variance at 25 points within half a metre, from data at most 1 s old. Truth is a sum of dipoles.
The peer is the published recursion over a room, its domain declared beforehand; it gets the same samples there.
"""

import tempfile
from pathlib import Path

import numpy as np
from bench_field import dipole_field
from threadpoolctl import threadpool_limits

from magmatch.data.recordings import load_recordings
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.inducing.gaussian_grid import lay_inducing_grid
from magmatch.field.inducing.kernels import DIVERGENCE_FREE, Kernel
from magmatch.field.live import estimator as live
from magmatch.published.recursion import RecursiveField
from magmatch_evaluation.script import UT, arguments, rmse_ut, timed

RATE, SPEED = 200, 1.0
H = Hyperparameters(0.8, 8 * UT, 0.4 * UT, 0.2, 100.0)
WITHIN = 4.0  # m; sources further away than this hardly vary along the walk, and cost time


def walk(n, rng):
    """Positions along loops that drift through a building, at 1 m above its floor."""
    s = SPEED * np.arange(n) / RATE
    x = np.c_[s / 12, 6 * np.sin(s / 6), 1.0 + 0.02 * np.sin(3 * s)]
    return x + 0.002 * rng.normal(size=x.shape)


class Building:
    """Dipoles in walls and floor around a walk."""

    def __init__(self, x, rng):
        low, high = x.min(axis=0) - 1, x.max(axis=0) + 1
        n = int(1.2 * np.prod(high[:2] - low[:2]))
        self.position = np.c_[rng.uniform(low[:2], high[:2], (n, 2)), rng.uniform(-0.6, 0.0, n)]
        self.moment = rng.normal(size=(n, 3)) * 2.0 * UT

    def field(self, x):
        """Field at points that lie along the walk, T."""
        out = np.empty_like(x)
        for rows in np.array_split(np.arange(len(x)), max(1, len(x) // 500)):
            near = (np.abs(self.position[:, :2] - x[rows].mean(axis=0)[:2]) < WITHIN + 4).all(axis=1)
            out[rows] = dipole_field(x[rows], self.position[near], self.moment[near])
        return out


def show(name, seconds, note=""):
    p50, p99 = np.percentile(seconds, [50, 99]) * 1e3
    print(f"    {name}: p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {max(seconds) * 1e3:.1f} ms{note}")


def run_live(x, b, building, rng, block):
    """Feed the walk, and ask along the way."""
    live.BLOCK, now = block, [0.0]
    estimator, seconds, _ = timed(live.FieldEstimator, H, clock=lambda: now[0])
    print(f"    construction (compiles, or loads what was compiled): {seconds:.1f} s")
    updates, predictions, errors, scaled = np.empty(len(x)), [], [], []
    for i in range(len(x)):
        now[0] = i / RATE
        updates[i] = timed(estimator.update, x[i], b[i]).clock
        if i % RATE == RATE - 1:
            q = x[i] + rng.uniform(-0.3, 0.3, (25, 3)) * [1, 1, 0.1]
            n_fits = estimator._tiles.n_fits
            found, seconds, _ = timed(estimator.predict, q, order=1, max_age=1.0)
            predictions.append((seconds, len(estimator._tiles.blocks), estimator._tiles.n_fits - n_fits))
            error = found.field - building.field(q)
            errors.append((error**2).sum(axis=1))
            scaled.append(np.abs(error) < 1.96 * np.sqrt(found.variance))
    print(f"    sustained: {len(x) / updates.sum():,.0f} updates a second, one sample each")
    show("update", updates)
    seconds, blocks, fits = np.array(predictions).T
    quarter = len(seconds) // 4
    show("predict", seconds, f", {fits.mean():.1f} blocks fitted a call")
    for name, rows in (("first", slice(quarter)), ("last", slice(-quarter, None))):
        show(f"predict, {name} quarter ({blocks[rows].mean():.0f} blocks visited)", seconds[rows])
    duty = (updates.sum() + seconds.sum()) / (len(x) / RATE)
    print(f"    share of one core, predictions included: {100 * duty:.0f} %")
    rmse = np.sqrt(np.concatenate(errors).mean()) / UT
    print(f"    field ahead of and beside the robot: RMSE {rmse:.2f} uT, 95 % intervals cover {np.mean(scaled):.1%}")
    return estimator


def show_age(estimator, x, b):
    """How old the youngest sample in a prediction is, by asking for the change that each new sample makes."""
    before = estimator.predict(x[-1:]).field
    estimator.update(x[-1], b[-1] + 20 * UT)
    after = estimator.predict(x[-1:]).field
    assert not np.array_equal(before, after)
    print("    max_age=0: the very last sample is in the prediction; max_age=1: samples younger than 1 s may wait")


def show_memory(estimator, n):
    cells = sum(int((b.seen > 0).sum()) for b in estimator._tiles.blocks.values())
    size = estimator.n_bytes
    each = size / cells / 1e3
    print(f"    memory: {size / 1e6:.0f} MB for {cells:,} visited cells ({each:.1f} kB each), {n:,} samples")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.live"
        saving = timed(estimator.save, path).clock
        again, loading, _ = timed(live.FieldEstimator.load, path)
        size = path.stat().st_size / 1e6
    print(f"    checkpoint: {size:.0f} MB, saved in {saving:.1f} s, resumed in {loading:.1f} s")
    assert len(again) == len(estimator)


def run_peer(x, b, half, n_updates=100):
    """Published recursion over a room that the walk crosses."""
    here = np.all(np.abs(x - x[len(x) // 2]) < [half, half, 1.0], axis=1)
    x, b = x[here], b[here]
    kernel = Kernel(DIVERGENCE_FREE, H.lengthscale, H.signal_sd)
    nodes = lay_inducing_grid(x, 0.6 * H.lengthscale, H.lengthscale).nodes
    state = RecursiveField.start(kernel, nodes, H.noise_sd, constant_sd=1e-4)
    seconds = []
    for i in range(min(n_updates, len(x))):
        state, clock, _ = timed(state.update, x[i : i + 1], b[i : i + 1])
        seconds.append(clock)
    rate = len(seconds) / sum(seconds)
    print(f"published recursion, {len(nodes)} inducing points, room of {2 * half:.0f} m: {rate:,.0f} a second")
    show("update", seconds)
    clock = timed(state.mean, x[:25], 1).clock + timed(state.dtc_covariance, x[:25]).clock
    print(f"    predict, 25 points: {clock * 1e3:.1f} ms")
    print(f"    memory: {2 * state.white_covariance.nbytes / 1e6:.0f} MB, growing with the square of the area")


def run_building(one, two):
    """Walk one of a real building, one sample per call and nothing given, predicting walk two."""
    estimator = live.FieldEstimator()
    seconds = [timed(estimator.update, *sample).clock for sample in zip(one.positions, one.field, strict=True)]
    print(f"building (CEA), {len(one):,} samples, hyperparameters from the first: {estimator.hyperparameters}")
    show("update", seconds, " (the one that chose them)")
    found, clock, _ = timed(estimator.predict, two.positions)
    n = estimator._tiles.n_fits
    print(f"    predict all {len(two):,} points of walk two: {clock:.1f} s, {n} blocks fitted")
    sd = np.sqrt(found.variance + estimator.hyperparameters.noise_sd**2)
    cover = np.mean(np.abs(found.field - two.field) < 1.96 * sd)
    print(f"    RMSE {rmse_ut(found.field, two.field):.2f} uT, 95 % intervals cover {cover:.1%}")


def main():
    asked = arguments(__doc__, samples=200_000, block=live.BLOCK, recordings=None)
    rng = np.random.default_rng(0)
    x = walk(asked.samples, rng)
    building = Building(x, rng)
    b = building.field(x) + 0.3 * UT * rng.normal(size=x.shape)
    area = np.prod(np.ptp(x[:, :2], axis=0))
    print(f"live: {len(x):,} samples over {area:.0f} m^2, {len(x) / RATE:.0f} s of walking, blocks of {asked.block}")
    estimator = run_live(x, b, building, rng, asked.block)
    show_age(estimator, x, b)
    show_memory(estimator, len(x))
    for half in (2.0, 6.0):
        run_peer(x, b, half)
    if asked.recordings:
        walks = load_recordings("cea", asked.recordings)
        run_building(walks["training"], walks["test"])


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
