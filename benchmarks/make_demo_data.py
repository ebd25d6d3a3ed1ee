# SPDX-License-Identifier: BSD-3-Clause
"""Make the packaged demo data: the office seen from two frames, 1,500 samples each, seven significant digits.

python benchmarks/make_demo_data.py [--out src/magmatch/data/samples/office]
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from magmatch import Survey, simulate
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import write_pair
from magmatch_evaluation.script import arguments

HOME = Path(__file__).parents[1] / "src/magmatch/data/samples/office"
SCENARIO, SEED, N_SAMPLES, N_DIGITS = "office", 1, 1500, 7


def main() -> None:
    out = arguments(__doc__, out=Path).out or HOME
    pair = simulate(SCENARIO, SEED, SimulationConfig(n_samples=N_SAMPLES))
    write_pair(replace(pair, base=shortened(pair.base), target=shortened(pair.target)), out)
    for file in sorted(out.iterdir()):
        print(f"{file.name:12s} {file.stat().st_size / 1e3:6.1f} kB")


def shortened(survey: Survey) -> Survey:
    """Round to the digits worth packaging: micrometres and tens of picotesla."""
    return replace(survey, positions=rounded(survey.positions), field=rounded(survey.field))


def rounded(values: np.ndarray) -> np.ndarray:
    """Round to significant digits."""
    return np.array([float(f"{value:.{N_DIGITS}g}") for value in values.flat]).reshape(values.shape)


if __name__ == "__main__":
    main()
