"""Register surveys that are clean, corrupted by clock and sensor errors, and corrupted but prepared.

python benchmarks/experiments/prepared_pairs.py [--seeds 10] [--scenario office-hand-held]
    [--hard-iron-ut 30] [--soft-iron 0.05] [--clock-offset-ms 40] [--spikes 0] [--spin]
python benchmarks/experiments/prepared_pairs.py kok/eight jidling/volume [--from FOLDER]

The target is corrupted. Errors are of the best pose, also where it was refused; those of the claim are 30 uT, 5 % and
40 ms. With --spin the target's sensor was turned about by hand
beforehand (500 readings), which a robot that turns about the vertical only cannot do without.

Recordings that are named, and hold orientations, are prepared instead, and their halves registered as recorded and as
prepared. The truth between halves is the identity, up to the recording's own drift. A sensor is calibrated on the
whole recording, both halves having the same one; the registration sees either half alone.
"""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.field.config import SPLINE
from magmatch.preparation.calibrate_in_place import fit_ellipsoid
from magmatch.preparation.preparation_report import PreparationReport
from magmatch.preparation.prepare import prepare
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.simulation.corruption import Corruption, corrupt, draw_corruption
from magmatch_evaluation.script import arguments, pose_error, timed
from magmatch_evaluation.survey_pairs import in_halves


def main() -> None:
    asked = arguments(
        __doc__, (), recordings=None, seeds=10, first=0, scenario="office-hand-held", hard_iron_ut=30.0,
        soft_iron=0.05, clock_offset_ms=40.0, spikes=0, spin=False,
    )  # fmt: skip
    for name in asked.words:
        show_halves(name, asked.recordings)
    if asked.words:
        return
    print("seed  clean: mm, deg | corrupted: mm, deg | prepared: mm, deg | clock ms, hard uT, soft %: off by | s")
    rows = []
    for seed in range(asked.first, asked.first + asked.seeds):
        rows.append(run(seed, asked))
        print(f"{seed:4d}  {as_text(rows[-1])}", flush=True)
    median = np.median(rows, axis=0)
    print(f"median {as_text(median)}")
    accepted = (np.array(rows)[:, [2, 5, 8]] > 0).sum(axis=0)
    print(f"accepted: clean {accepted[0]}, corrupted {accepted[1]}, prepared {accepted[2]} of {len(rows)}")
    print(f"prepared / clean, of the medians: {median[6] / median[0]:.2f} (mm), {median[7] / median[1]:.2f} (deg)")


def show_halves(name: str, recordings: Path | None) -> None:
    """Prepare a recording, and register its second half against the first, from a random frame."""
    dataset, recording = name.split("/")
    survey = load_recordings(dataset, recordings)[recording]
    prepared, report = prepare(survey)
    print(f"== {name}: {len(survey)} samples\n{report.table()}")
    for label, s in (("as recorded", survey), ("as prepared", prepared)):
        pair = in_halves(s, np.random.default_rng(0))
        result = mm.register(pair.base, pair.target)
        distance, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
        print(f"halves {label}: {result.status}, {1e3 * distance:.0f} mm, {np.degrees(angle):.2f} deg", flush=True)


def run(seed: int, asked: Namespace) -> list[float]:
    """One pair: (mm, deg, accepted) clean, corrupted, prepared; errors of the estimates; seconds of preparing."""
    pair = mm.simulate(asked.scenario, seed)
    rng = np.random.default_rng(seed)
    raw, corruption = corrupted(pair.target, asked, rng)
    (prepared, report), seconds, _ = timed(prepare, raw, sensor=spun(corruption, rng) if asked.spin else None)
    base_map = mm.build_map(pair.base, SPLINE)
    row: list[float] = []
    for target in (pair.target, raw, prepared):
        result = mm.register(base_map, target)
        distance, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
        row += [1e3 * distance, np.degrees(angle), float(result.is_accepted)]
    return [*row, *estimate_errors(report, corruption), seconds]


def corrupted(survey: mm.Survey, asked: Namespace, rng: np.random.Generator) -> tuple[mm.Survey, Corruption]:
    """The survey with errors of the sizes asked for."""
    drawn = draw_corruption(rng, 1e-6 * asked.hard_iron_ut, asked.soft_iron, 1e-3 * asked.clock_offset_ms)
    drawn = replace(drawn, n_spikes=asked.spikes)
    return corrupt(survey, drawn, rng)[0], drawn


def spun(corruption: Corruption, rng: np.random.Generator) -> SensorCorrection:
    """What turning the sensor about in one place tells of it."""
    field = Rotation.random(500, rng=rng).apply([17.83e-6, 0.0, -44.57e-6])
    readings = field @ corruption.soft_iron.T + corruption.hard_iron + 0.4e-6 * rng.standard_normal(field.shape)
    return fit_ellipsoid(readings)[0]


def estimate_errors(report: PreparationReport, truth: Corruption) -> list[float]:
    """Clock offset (ms), hard iron (uT, worst axis among those not open) and soft iron (%, largest entry)."""
    offset = report["time offset"]
    clock = (offset.figures["estimate"][0] if offset.outcome == "applied" else 0.0) - truth.clock_offset
    is_known = ~np.array(report["hard iron"].figures["is_open"]) | (report["known sensor"].outcome == "applied")
    hard = (report.sensor.hard_iron - truth.hard_iron)[is_known]
    soft = report.sensor.soft_iron - truth.soft_iron / np.cbrt(np.linalg.det(truth.soft_iron))
    return [1e3 * abs(clock), 1e6 * np.abs(hard).max(initial=0.0), 100 * np.abs(soft).max()]


def as_text(row: list[float] | np.ndarray) -> str:
    shown = [f"{row[k]:8.2f} {row[k + 1]:7.3f}{'' if row[k + 2] else ' x'}" for k in (0, 3, 6)]
    return " | ".join([*shown, f"{row[9]:6.2f} {row[10]:6.3f} {row[11]:6.3f}", f"{row[12]:5.1f}"])


if __name__ == "__main__":
    main()
