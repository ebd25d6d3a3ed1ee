"""Kok's walks: how well the map of one half of a log predicts the other half's field, before and after correction.

    python benchmarks/experiments/slam_laps.py --data DIR [--sd 0.05,0.5] [--save NAME]

DIR holds Kok's recordings (`kok/*.mat`). Their visual-inertial poses, which drift by 0.1 to 0.2 m, are the odometry,
of which slam is told ``--sd`` (m, deg after 10 m). The first half of the log, by path, is mapped; of the second half
the samples count that lie within half a field length of the first, with and without the correction alike. Error: rms
of the predicted vector.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import magmatch as mm
from magmatch.data.recordings import load_recordings
from magmatch.field.config import SPLINE
from magmatch.geometry import path_walked
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, rmse_ut, timed

COLUMNS = ("place", "m", "closures", "moved by up to, m", "samples", "as recorded, uT", "corrected, uT", "ratio", "s")
PLACES = ("eight", "square", "library", "mall")


def halves(log: mm.Survey) -> tuple[np.ndarray, np.ndarray]:
    """Samples of the first and of the second half of the path."""
    walked = path_walked(log.positions)
    is_first = walked < walked[-1] / 2
    return np.flatnonzero(is_first), np.flatnonzero(~is_first)


def near(log: mm.Survey, first: np.ndarray, second: np.ndarray, distance: float) -> np.ndarray:
    """Of each sample of the second half, whether the first half passes near it."""
    return cKDTree(log.positions[first]).query(log.positions[second])[0] < distance


def missed(log: mm.Survey, first: np.ndarray, rows: np.ndarray) -> float:
    """Rms error of the field of some samples, predicted from the first half, uT."""
    seen = mm.build_map(log.subset(first), SPLINE).evaluate(log.positions[rows])
    return rmse_ut(seen.field, log.field[rows])


def main() -> None:
    asked = arguments(__doc__, data=Path, sd="0.05,0.5", save=saver)
    shift, turn = map(float, asked.sd.split(","))
    config = mm.SlamConfig.model_validate({"odometry": {"sd": (shift, turn)}})
    logs = load_recordings("kok", asked.data / "kok")
    table = []
    for name in PLACES:
        log = logs[name]
        session, seconds, _ = timed(mm.slam, log, config)
        after = session.trajectories[0]
        # The sensor's bias is corrected for both.
        before = mm.Survey(log.positions, session.paths[0].survey.field, log.times, log.orientations, name=log.name)
        distance = session.paths[0].windows[0].length / 2
        first, second = halves(log)
        rows = second[near(before, first, second, distance) & near(after, first, second, distance)]
        errors = [missed(one, first, rows) for one in (before, after)] if len(rows) else [np.nan, np.nan]
        table.append([
            name, f"{path_walked(log.positions)[-1]:.0f}", len(session.graph.closures),
            f"{np.linalg.norm(after.positions - log.positions, axis=1).max():.2f}", len(rows),
            f"{errors[0]:.2f}", f"{errors[1]:.2f}", f"{errors[1] / errors[0]:.2f}", f"{seconds:.0f}",
        ])  # fmt: skip
    show(COLUMNS, table, asked.save)


if __name__ == "__main__":
    main()
