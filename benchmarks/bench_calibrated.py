"""What a calibrated second pass costs, in CPU seconds of the first.

    python benchmarks/bench_calibrated.py [--from FOLDER] [--names kok/library jidling/volume] [--rooms 2]

Halves of recordings as they are; rooms are `office-hand-held` with 30 uT of hard iron, 5 % of soft iron and clocks
40 ms off, of both surveys. Second over first: how much longer it takes with ``calibrate`` than without, over without.
"""

import logging
import time
from collections.abc import Iterator

import numpy as np

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.registration.config import RegistrationConfig
from magmatch.simulation.corruption import corrupt, draw_corruption
from magmatch_evaluation.script import arguments
from magmatch_evaluation.survey_pairs import in_halves


def pairs(folder: str | None, names: list[str], n_rooms: int) -> Iterator[tuple[str, mm.Survey, mm.Survey]]:
    for name in names:
        dataset, recording = name.split("/")
        halves = in_halves(load_recordings(dataset, folder)[recording], np.random.default_rng(0))
        yield name, halves.base, halves.target
    for seed in range(40, 40 + n_rooms):
        pair, rng = mm.simulate("office-hand-held", seed), np.random.default_rng(seed)
        spoilt = [corrupt(s, draw_corruption(rng, 30e-6, 0.05, 0.04), rng)[0] for s in (pair.base, pair.target)]
        yield f"room {seed}", spoilt[0], spoilt[1]


def main() -> None:
    asked = arguments(__doc__, recordings=None, names=["kok/library", "jidling/volume"], rooms=2)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    mm.register(*(mm.simulate("table", 0).base,) * 2)  # compiles
    for name, base, target in pairs(asked.recordings, asked.names, asked.rooms):
        taken = []
        for calibrate in (False, True):
            start = time.process_time()
            mm.register(base, target, RegistrationConfig(calibrate=calibrate))
            taken.append(time.process_time() - start)
        print(f"{name}: {taken[0]:.1f} s, second over first {taken[1] / taken[0] - 1:.2f}", flush=True)


if __name__ == "__main__":
    main()
