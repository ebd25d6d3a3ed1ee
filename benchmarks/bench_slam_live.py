# SPDX-License-Identifier: BSD-3-Clause
"""Live slam: how many times faster than the walk it is, how long a window takes, and where the poses end up.

Each log is fed sample by sample; seconds are of the processor, those of the last tenth of the walk apart: they grow
with what was walked before. Errors are root mean squares after one rigid alignment: of odometry, of the poses as they
were said when their sample came, of the whole path as known at the end, and after `finish`, which gives what `slam`
gives.

Run: PYTHONPATH=tests python benchmarks/bench_slam_live.py [--laps N] [--seeds N]
"""

from time import process_time

import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from drifting import Place, drifting_walk, trajectory_error
from magmatch_evaluation.script import arguments


def main() -> None:
    asked = arguments(__doc__, laps=4.0, seeds=3)
    mm.slam(drifting_walk(Place(0), 0)[0])  # loops are compiled
    print("seed  path m  walk s  times real time  last tenth  window s (median, most)  closures  error m: odometry  "
          "as said  at the end  finished")  # fmt: skip
    for seed in range(1, asked.seeds + 1):
        log, truth = drifting_walk(Place(seed), seed, laps=asked.laps)
        session, said, windows, spent = mm.Session(), [], [], []
        for k in range(len(log)):
            T = RigidTransform.from_components(log.positions[k], log.orientations[k])
            b = log.orientations[k].inv().apply(log.field[k])
            start = process_time()
            is_changed = session.add(float(log.times[k]), T, b)
            said.append(session.pose().translation)
            spent.append(process_time() - start)
            windows += [spent[-1]] if is_changed else []
        known = session.trajectories[0].positions
        n_closures, walk, tenth = len(session.graph.closures), log.times[-1] - log.times[0], len(log) // 10
        session.finish(log.name)
        errors = [
            trajectory_error(truth[: len(p)], p)
            for p in (log.positions, np.array(said), known, session.trajectories[0].positions)
        ]
        late = sum(spent[-tenth:])
        print(
            f"{seed:4d}  {session.paths[0].walked[-1]:6.1f}  {walk:6.1f}  {walk / sum(spent):15.1f}  "
            f"{walk / 10 / late:10.1f}  {np.median(windows):13.2f}, {max(windows):8.2f}  "
            f"{n_closures:8d}  " + "  ".join(f"{e:.3f}" for e in errors)
        )


if __name__ == "__main__":
    main()
