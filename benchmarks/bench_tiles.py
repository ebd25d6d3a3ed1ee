# SPDX-License-Identifier: BSD-3-Clause
"""Large maps: time, memory and accuracy from 10 to 10,000 m^2; OPENBLAS_NUM_THREADS=1 gives the one-thread figures.

Usage: python benchmarks/bench_tiles.py [office|million|doubling|agreement ...]

Each case runs in a process of its own, so that its peak memory is its own. Surveys are walked in lanes over a floor,
a sensor at 1 m height, dipoles 0.4 to 1.2 m under the floor and in the walls; noise is 0.3 uT. Menzen et al. 2023
(D-SKI) report under two minutes for 40,000 three-axis samples on a laptop.
"""

import json
import logging
import sys
import tempfile
from pathlib import Path

import numpy as np

from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.tiles.region_model import TiledModel
from magmatch.field.tiles.tiles import Tiling
from magmatch.simulation.paths import resample
from magmatch_evaluation.script import UT, alone, arguments, peak_mib, rmse_ut, timed

CELL = 4.0


def dipoles(extent, rng):
    """Sources under a floor: positions and moments (T m^3)."""
    n = int(0.5 * np.prod(np.add(extent, 4)))
    position = np.c_[rng.uniform(-2, np.add(extent, 2), (n, 2)), -rng.uniform(0.4, 1.2, n)]
    return position, rng.normal(size=(n, 3)) * rng.lognormal(0, 0.7, (n, 1)) * 4 * UT


def field_at(x, sources):
    """Field (T) of the sources within 5 m (the rest counts as the Earth's), bucket by bucket."""
    position, moment = sources
    out = np.tile(np.array([18.0, 3.0, -45.0]) * UT, (len(x), 1))
    bucket = np.floor(x[:, :2] / CELL).astype(int)
    keys, inverse = np.unique(bucket, axis=0, return_inverse=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    cuts = np.searchsorted(inverse.ravel()[order], np.arange(1, len(keys)))
    for key, rows in zip(keys, np.split(order, cuts), strict=True):
        near = np.flatnonzero(np.all(np.abs(position[:, :2] - (key + 0.5) * CELL) < CELL / 2 + 5, axis=1))
        for part in np.array_split(rows, max(1, len(rows) // 2000)):
            r = x[part, None] - position[near]
            d2 = (r**2).sum(axis=2)
            # Smoothly to zero at 5 m, so that the field has no steps where a source leaves the list.
            fade = np.clip(1 - np.hypot(r[..., 0], r[..., 1]) / 5, 0, 1) ** 2 / d2**2.5
            along = 3 * (r * moment[near]).sum(axis=2) * fade
            out[part] += np.einsum("nk,nka->na", along, r) - (fade * d2) @ moment[near]
    return out


def walk(extent, n, gap):
    """Lanes along both axes of a floor, samples evenly along them, the sensor swaying by 2 cm."""
    rng = np.random.default_rng(0)
    lanes = []
    for axis in range(2):
        for k, at in enumerate(np.arange(gap / 2, extent[1 - axis], gap * (1 + axis))):
            lane = np.empty((2, 2))
            lane[:, axis], lane[:, 1 - axis] = (0, extent[axis]) if k % 2 else (extent[axis], 0), at
            lanes.append(lane)
    corners = np.concatenate(lanes)
    x = resample(np.c_[corners, np.ones(len(corners))], n)
    sway = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    sway = sway - np.stack([np.convolve(c, np.ones(201) / 201, "same") for c in sway.T], axis=1)
    x += np.clip(0.02 * sway / sway.std(axis=0), -0.08, 0.08)
    sources = dipoles(extent, rng)
    return Survey(x, field_at(x, sources) + 0.3 * UT * rng.normal(size=x.shape)), sources


def measure(extent, n, gap, config, label):
    """Build a map in this process, and print what it took and how right it is."""
    survey, sources = walk(extent, n, gap)
    build_map(walk((3, 3), 500, 0.6)[0], SPLINE)  # compiles
    before = peak_mib() / 1024
    field_map, seconds, cpu = timed(build_map, survey, config)
    rng = np.random.default_rng(1)
    q = np.c_[rng.uniform(0.3, np.subtract(extent, 0.3), (4000, 2)), rng.uniform(0.97, 1.03, 4000)]
    rmse, peak = rmse_ut(field_map.evaluate(q).field, field_at(q, sources)), peak_mib() / 1024
    h = field_map.hyperparameters
    tiles = len(getattr(field_map.posterior, "tiles", [0]))
    print(
        f"{label}: {n:,} samples, {np.prod(extent):,.0f} m^2, spacing {h.spacing:.2f} m, lengthscale "
        f"{h.lengthscale:.2f} m, {tiles} tiles: {seconds:.2f} s ({cpu:.2f} s of this process, "
        f"{1e6 * cpu / n:.1f} us a sample), peak {peak:.2f} GiB ({before:.2f} before), RMSE {rmse:.3f} uT",
        flush=True,
    )
    return field_map, [cpu, peak]


def office():
    return measure((40.0, 20.0), 40_000, 1.0, SPLINE, "office floor")[1]


def million():
    field_map, cost = measure((100.0, 100.0), 1_000_000, 1.5, SPLINE, "100 x 100 m")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.map"
        saving, loading = timed(field_map.save, path).clock, timed(FieldMap.load, path).clock
    print(f"    save {saving:.1f} s, load {loading:.1f} s, peak {peak_mib() / 1024:.2f} GiB")
    return cost


def agreement():
    """Tiles of several sizes against one large fit of the same samples."""
    survey, sources = walk((20.0, 16.0), 16_000, 1.0)
    T = survey.principal_frame().inv()
    samples, rng = survey.transformed(T), np.random.default_rng(1)
    q = np.c_[rng.uniform(0.3, [19.7, 15.7], (6000, 2)), rng.uniform(0.97, 1.03, 6000)]
    truth, q = T.rotation.apply(field_at(q, sources)), T.apply(q)
    h = Hyperparameters(1.16, 1.6 * UT, 0.35 * UT, 0.33, 3000.0, prior_scale=22.0, inflation=1.7)
    model = SplineModel.over(samples.positions, h)
    whole = model.infer(model.observe(samples.positions, samples.field))
    expected, sd = whole.evaluate(q, 1), np.sqrt(np.trace(whole.covariance(q), axis1=1, axis2=2))
    scale = np.sqrt((expected.gradient**2).sum(axis=(1, 2)).mean())
    print(f"one fit: RMSE {rms(expected.field - truth) / UT:.3f} uT, sd {np.sqrt((sd**2).mean()) / UT:.3f} uT")
    for core, margin in ((24, 3), (24, 4), (24, 5), (24, 6), (24, 8), (16, 5), (32, 5)):
        tiled = TiledModel.over(samples.positions, h, Tiling(h.spacing, margin, 2, core))
        posterior, _, seconds = timed(lambda t=tiled: t.infer(t.observe(samples.positions, samples.field)))
        values = posterior.evaluate(q, 1)
        gradient = values.gradient
        curl = np.abs(gradient - gradient.transpose(0, 2, 1)).max(axis=(1, 2))
        off = rms((values.field - expected.field) / sd[:, None])
        bent = rms((gradient - expected.gradient).reshape(len(q), 9)) / scale
        print(
            f"core {core}, margin {margin}: {len(tiled.tiles)} tiles, {seconds:.2f} s; differs by {off:.2f} sd "
            f"(rms), gradient by {bent:.1%}; curl at {(curl > 1e-12).mean():.0%} of points, rms "
            f"{rms(curl[:, None]) / scale:.1%} of the gradient; RMSE {rms(values.field - truth) / UT:.3f} uT"
        )


def rms(rows):
    """Root of the mean squared length of rows."""
    return np.sqrt((rows**2).sum(axis=1).mean())


# The same numbers for all sizes: what is measured is the fit.
FIXED = {"lengthscale": 1.2, "signal_sd": 4 * UT, "noise_sd": 0.5 * UT, "spacing": 0.35}


def doubling(area):
    """One area at 100 samples a square metre."""
    side = np.sqrt(area)
    return measure((side, side), int(100 * area), min(1.0, side / 3), SPLINE.model_copy(update=FIXED), "doubling")[1]


def main():
    """Run every case, and every size of one, in a process of its own, and print how much more each size costs."""
    cases = {"office": office, "million": million, "doubling": doubling, "agreement": agreement}
    asked = arguments(__doc__, tuple(cases), size=float, is_alone=False)
    logging.basicConfig(level=logging.WARNING)
    if asked.is_alone:
        size = [] if asked.size is None else [asked.size]
        print(json.dumps(cases[asked.words[0]](*size)))
        return
    sizes = {"doubling": [10 * 2.0**k for k in range(11)]}
    for case in asked.words:
        before = None
        for size in sizes.get(case, [None]):
            words = [] if size is None else ["--size", size]
            cost = alone(__file__, case, "--is-alone", *words)
            if before is not None:
                ratio = np.divide(cost, before)
                print(f"    times the size before: processor time {ratio[0]:.2f}, peak memory {ratio[1]:.2f}")
            before = cost
            sys.stdout.flush()


if __name__ == "__main__":
    main()
