# SPDX-License-Identifier: BSD-3-Clause
"""A robot that does not know where it starts finds itself in a map of its room, sample by sample.

Run: python examples/05_localize.py [MAP LOG.csv]
"""

import sys

import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch as mm


def main(*paths: str) -> None:
    pair = None if paths else mm.simulate("office-robot", seed=1)
    field_map = mm.build_map(pair.base) if pair else mm.FieldMap.load(paths[0])
    log = pair.target.subset(np.arange(1200)) if pair else mm.read_survey(paths[1])
    # The simulated robot's odometry begins in any attitude; as a rule z is up.
    config = mm.LocalizerConfig(is_gravity_aligned=pair is None)

    localizer = mm.Localizer(field_map, config)
    poses, status = [], None
    for t, T_odom_body, field in samples_of(log):
        localizer.update(t, T_odom_body, field)
        now = localizer.estimate()
        poses.append(now.T_map_body)
        if now.status != status:
            print(f"{t:6.2f} s  {now.status}: {now.reason}")
            status = now.status

    stated = [n for n, T in enumerate(poses) if T is not None]
    print(f"a pose for {len(stated)} of {len(poses)} samples")
    if pair and stated:
        truth = pair.T_base_target.apply(log.positions)
        off = [np.linalg.norm(poses[n].translation - truth[n]) for n in stated]
        print(f"off by {np.median(off):.3f} m in the median, {max(off):.3f} m at most")


def samples_of(log: mm.Survey):
    """Time, pose of the body in the odometry's frame, and field in the body's axes."""
    R = log.orientations
    field = R.inv().apply(log.field)
    for n, t in enumerate(log.times):
        yield t, RigidTransform.from_components(log.positions[n], R[n]), field[n]


if __name__ == "__main__":
    main(*sys.argv[1:])
