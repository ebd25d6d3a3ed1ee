# SPDX-License-Identifier: BSD-3-Clause
"""Build a field map from a survey, save it, and ask it for the field at points.

Run: python examples/01_build_map.py [SURVEY.csv]
"""

import sys
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import magmatch as mm


def main(path: str | None = None) -> None:
    survey = mm.read_survey(path or str(files(mm) / "data" / "samples" / "office" / "base.csv"))
    field_map = mm.build_map(survey)
    numbers = field_map.hyperparameters
    print(f"{len(survey)} samples, lengthscale {numbers.lengthscale:.2f} m, noise {1e6 * numbers.noise_sd:.2f} uT")

    p = survey.centroid + np.array([[0, 0, 0], [50, 0, 0]])  # in the middle, and far from all samples
    field = field_map.evaluate(p).field
    sd = np.sqrt(np.diagonal(field_map.covariance(p), axis1=1, axis2=2))
    for point, b, s, known in zip(p, field, sd, field_map.knows(p), strict=True):
        words = "known" if known else "not known: the prior's spread"
        print(f"at {point.round(2)} m: B = {(1e6 * b).round(1)} uT +- {(1e6 * s).round(2)} uT ({words})")

    with TemporaryDirectory() as folder:
        saved = Path(folder) / "office.map"
        field_map.save(saved)
        again = mm.FieldMap.load(saved)
        print("loading gives the same field:", bool((again.evaluate(p).field == field).all()))


if __name__ == "__main__":
    main(*sys.argv[1:2])
