# SPDX-License-Identifier: BSD-3-Clause
"""Register two surveys of one place, and say what came out, whichever way it went.

Run: python examples/02_register_maps.py [BASE.csv TARGET.csv]
"""

import sys
from importlib.resources import files

import numpy as np

import magmatch as mm


def main(base_path: str | None = None, target_path: str | None = None) -> None:
    office = files(mm) / "data" / "samples" / "office"
    base = mm.read_survey(base_path or str(office / "base.csv"))
    target = mm.read_survey(target_path or str(office / "target.csv"))

    result = mm.register(base, target, seed=0)

    print(f"{result.status}: {result.reason}")
    if not result.is_accepted:
        for alternative in result.alternatives[:1]:
            print("best candidate, not to be trusted:\n", alternative.T_base_target.as_matrix().round(3))
        return
    T_base_target = result.T_base_target  # a SciPy RigidTransform
    print(
        f"turned by {np.rad2deg(T_base_target.rotation.magnitude()):.2f} deg, moved by {T_base_target.translation} m"
    )
    if result.covariance is not None:
        sd = np.sqrt(np.diag(result.covariance))
        print(f"standard deviations: {np.rad2deg(sd[:3]).round(3)} deg, {(1e3 * sd[3:]).round(1)} mm")

    aligned = target.transformed(T_base_target, frame=base.frame)  # positions move, field vectors turn
    print("centroid of the target in the base frame:", aligned.centroid.round(3), "m")


if __name__ == "__main__":
    main(*sys.argv[1:3])
