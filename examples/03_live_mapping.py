# SPDX-License-Identifier: BSD-3-Clause
"""Map while walking: samples in one by one, predictions ahead, a checkpoint, and a map at the end.

Run: python examples/03_live_mapping.py [SURVEY.csv]
"""

import sys
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import magmatch as mm


def main(path: str | None = None) -> None:
    survey = mm.read_survey(path or str(files(mm) / "data" / "samples" / "office" / "base.csv"))
    samples = list(zip(survey.positions, survey.field, strict=True))
    half = len(samples) // 2

    estimator = mm.FieldEstimator()  # no region declared, hyperparameters from the first samples
    missed = []
    for i, (position, field) in enumerate(samples[:half]):
        if i > 600 and i % 100 == 0:  # what does it expect, before the sample is in?
            ahead = estimator.predict(position[None], max_age=1.0)
            missed.append(np.linalg.norm(ahead.field[0] - field))
        estimator.update(position, field)  # orientation=(x, y, z, w) turns sensor vectors into the map
    print(f"{len(estimator)} samples in {estimator.n_bytes / 1e6:.2f} MB")
    print(f"a sample differs from what was expected by {1e6 * np.median(missed):.2f} uT (median)")

    with TemporaryDirectory() as folder:  # switch off, and go on tomorrow
        checkpoint = Path(folder) / "office.live"
        estimator.save(checkpoint)
        estimator = mm.FieldEstimator.load(checkpoint)
    estimator.update(survey.positions[half:], survey.field[half:])  # many at once are the same to it

    middle = estimator.predict(survey.centroid[None], order=1)
    b, sd = 1e6 * middle.field[0], 1e6 * np.sqrt(middle.variance[0])
    print(f"in the middle: B = {b.round(2)} uT +- {sd.round(2)} uT")
    field_map = estimator.to_map()
    print(
        f"as a map of {len(field_map.survey)} samples: {1e6 * field_map.evaluate(survey.centroid[None]).field[0]} uT"
    )


if __name__ == "__main__":
    main(*sys.argv[1:2])
