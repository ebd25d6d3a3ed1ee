"""Prepare recordings that hold orientations, and register their halves as recorded and as prepared.

python benchmarks/experiments/prepared_recordings.py [--from FOLDER] [--names kok/eight jidling/volume ...]

The truth between halves is the identity, up to the recording's own drift. A sensor is calibrated on the whole
recording, both halves having the same one; the registration sees either half alone.
"""

import numpy as np

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.preparation.prepare import prepare
from magmatch_evaluation.script import arguments, pose_error
from magmatch_evaluation.survey_pairs import in_halves

NAMES = ("kok/eight", "kok/square", "kok/library", "jidling/volume")


def main() -> None:
    asked = arguments(__doc__, recordings=None, names=list(NAMES))
    for name in asked.names:
        dataset, recording = name.split("/")
        survey = load_recordings(dataset, asked.recordings)[recording]
        prepared, report = prepare(survey)
        print(f"== {name}: {len(survey)} samples\n{report.table()}")
        for label, s in (("as recorded", survey), ("as prepared", prepared)):
            print(f"halves {label}: {registered(s)}", flush=True)


def registered(survey: mm.Survey) -> str:
    """Second half against the first, from a random frame."""
    pair = in_halves(survey, np.random.default_rng(0))
    result = mm.register(pair.base, pair.target)
    if result.best_pose is None:
        return str(result.status)
    distance, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
    return f"{result.status}, {1e3 * distance:.0f} mm, {np.degrees(angle):.2f} deg"


if __name__ == "__main__":
    main()
