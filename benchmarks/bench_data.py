# SPDX-License-Identifier: BSD-3-Clause
"""How long it takes to write, read and check a survey file of 100,000 samples with times and orientations."""

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch import Survey, read_survey

N_SAMPLES = 100_000
N_REPEATS = 5


def main() -> None:
    """Print the fastest of some repeats, in seconds."""
    rng = np.random.default_rng(0)
    positions = np.cumsum(rng.normal(scale=0.01, size=(N_SAMPLES, 3)), axis=0)
    field = np.array([18e-6, 3e-6, -45e-6]) + rng.normal(scale=2e-6, size=(N_SAMPLES, 3))
    survey = Survey(positions, field, 0.01 * np.arange(N_SAMPLES), Rotation.random(N_SAMPLES, rng=rng))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "survey.csv"
        seconds: dict[str, list[float]] = {"write": [], "read and check": []}
        for _ in range(N_REPEATS):
            start = perf_counter()
            survey.save(path)
            seconds["write"].append(perf_counter() - start)
            start = perf_counter()
            read_survey(path)
            seconds["read and check"].append(perf_counter() - start)
        print(f"{N_SAMPLES} samples, 11 columns, {path.stat().st_size / 1e6:.1f} MB")
    for step, values in seconds.items():
        print(f"{step:>15}: {min(values):.2f} s")


if __name__ == "__main__":
    main()
