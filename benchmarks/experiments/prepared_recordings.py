"""Prepare recordings that hold orientations, and register their halves as recorded and as prepared.

python benchmarks/experiments/prepared_recordings.py [--from FOLDER] [--names kok/eight jidling/volume ...]

The truth between halves is the identity, up to the recording's own drift. A sensor is calibrated on the whole
recording, both halves having the same one; the registration sees either half alone.
"""

import argparse
from pathlib import Path

import numpy as np

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.geometry import random_transform, transform_error
from magmatch.preparation.prepare import prepare

LOCAL = Path(__file__).parents[3] / "shared" / "data"
NAMES = ("kok/eight", "kok/square", "kok/library", "jidling/volume")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="source", type=Path, default=LOCAL if LOCAL.is_dir() else None)
    parser.add_argument("--names", nargs="+", default=list(NAMES))
    arguments = parser.parse_args()
    for name in arguments.names:
        dataset, recording = name.split("/")
        survey = load_recordings(dataset, arguments.source)[recording]
        prepared, report = prepare(survey)
        print(f"== {name}: {len(survey)} samples\n{report.table()}")
        for label, s in (("as recorded", survey), ("as prepared", prepared)):
            print(f"halves {label}: {registered(s)}", flush=True)


def registered(survey: mm.Survey) -> str:
    """Second half against the first, from a random frame."""
    half = np.arange(len(survey)) < len(survey) // 2
    base, target = survey.subset(half), survey.subset(~half)
    T_base_target = random_transform(np.random.default_rng(0))
    target = target.transformed(T_base_target.inv())
    result = mm.register(base, target)
    pose = result.best_pose
    if pose is None:
        return str(result.status)
    distance, angle = transform_error(pose, T_base_target, target.centroid)
    return f"{result.status}, {1e3 * distance:.0f} mm, {np.degrees(angle):.2f} deg"


if __name__ == "__main__":
    main()
