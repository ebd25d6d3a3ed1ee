# SPDX-License-Identifier: BSD-3-Clause
"""Two walks by dead reckoning along one corridor: drift corrected, both in one frame, one map.

Run: python examples/04_slam.py [LOG.csv ...]
"""

import sys

import numpy as np

import magmatch as mm


def main(*paths: str) -> None:
    pair = None if paths else mm.simulate("corridor", seed=1)
    logs = [pair.base, pair.target] if pair else [mm.read_survey(path) for path in paths]

    session = mm.slam(logs)

    result = session.result()
    print(f"{result.status}: {result.reason}")
    for log in result.logs:
        place, turn = log.sd
        print(
            f"{log.name}: frame {log.component}, {log.length:.1f} m, moved {log.moved:.2f} m, "
            f"its end known to {place:.2f} m and {np.rad2deg(turn):.1f} deg"
        )
    if not result.closures:
        return  # nothing was passed twice: the logs are as they came
    field_map = session.map()  # of the component with the longest path
    print(f"one map of {len(field_map.survey)} samples")
    T_map_log = result.logs[-1].T_map_log
    if pair and T_map_log is not None:
        center = pair.target.centroid
        off = T_map_log.apply(center) - pair.T_base_target.apply(center)
        print(f"the second walk lies {np.linalg.norm(off):.2f} m from where it was simulated")


if __name__ == "__main__":
    main(*sys.argv[1:])
