# SPDX-License-Identifier: BSD-3-Clause
"""A map as a factor in your own GTSAM graph: a robot's drifting odometry is held to the field of a known room.

Frames: `map`, in which the field is known, and `body`, with the magnetometer's axes. T_map_body takes body to map.
Units: m, rad and, in the factor, uT: GTSAM takes covariances below 1e-9 for zero, and in T^2 all of them are.
Run: python examples/07_gtsam_factor.py (needs: pip install gtsam)
"""

from itertools import pairwise

import gtsam
import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch as mm

UT = 1e6  # uT in a tesla
SPACING = 4  # samples from one node to the next, about 0.13 m here: nearer ones share the map's error
# Of odometry's step between two nodes: roll, pitch, yaw in rad, then x, y, z in m, in body axes.
STEP_SD = np.array([*np.deg2rad([0.1, 0.1, 1.5]), 0.004, 0.004, 0.001])
START_SD = np.array([*np.deg2rad([1.0, 1.0, 3.0]), 0.05, 0.05, 0.05])  # it starts at a dock, for example


def predict(field_map: mm.FieldMap, T_map_body: gtsam.Pose3) -> tuple[np.ndarray, np.ndarray]:
    """Field that a sensor at this pose would measure, uT in body axes (3,), and its Jacobian (3, 6).

    GTSAM disturbs a pose from the right, T Exp(xi), by xi = (rotation, translation) in body axes. Then the field
    R^T B(p) changes by b x rotation, as the body turns in it, and by R^T (dB/dp) R translation.
    """
    R, p = T_map_body.rotation().matrix(), T_map_body.translation()
    values = field_map.evaluate(p[None], order=1)  # gradient[i, a, b] = dB_a / dp_b, T/m
    b, gradient = UT * R.T @ values.field[0], UT * R.T @ values.gradient[0] @ R
    return b, np.hstack([gtsam.Rot3.Hat(b), gradient])


def field_factor(key: int, measured: np.ndarray, field_map: mm.FieldMap, guess: gtsam.Pose3) -> gtsam.CustomFactor:
    """Factor of one sample, uT in body axes; its covariance: the map's at the guess, and the sensor's noise."""
    R, p = guess.rotation().matrix(), guess.translation()
    noise_sd = field_map.hyperparameters.noise_sd  # of the sensor that made the map; that of yours, if you know it
    C_body = UT**2 * (R.T @ field_map.covariance(p[None])[0] @ R + noise_sd**2 * np.eye(3))

    def error(_factor, values, jacobians):
        b, J = predict(field_map, values.atPose3(key))
        if jacobians is not None:
            jacobians[0] = J
        return b - measured

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(C_body), [key], error)


def follow(field_map: mm.FieldMap, start: gtsam.Pose3, steps: list[gtsam.Pose3], fields: np.ndarray) -> gtsam.ISAM2:
    """Solve as the robot goes, node by node: so the guess of each new pose is near, where the map is almost linear.

    `steps` are odometry's, of each node seen from the one before; `fields` are in uT, in body axes, one a node.
    """
    solver, guess = gtsam.ISAM2(), start
    for k, field in enumerate(fields):
        graph, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.add(gtsam.PriorFactorPose3(0, start, gtsam.noiseModel.Diagonal.Sigmas(START_SD)))
        else:
            guess = solver.calculateEstimatePose3(k - 1).compose(steps[k - 1])
            noise = gtsam.noiseModel.Diagonal.Sigmas(STEP_SD)
            graph.add(gtsam.BetweenFactorPose3(k - 1, k, steps[k - 1], noise))
        if field_map.knows(guess.translation()[None])[0]:  # elsewhere the map has nothing to say
            graph.add(field_factor(k, field, field_map, guess))
        new.insert(k, guess)
        solver.update(graph, new)
    return solver


def main() -> None:
    pair = mm.simulate("office-robot", seed=1)  # two robots in one room; the first makes the map
    field_map = mm.build_map(pair.base.subset(np.arange(0, len(pair.base), 2)))
    # The second one's true poses and readings, in its own frame; T_base_target takes them into the map's.
    log = pair.target.subset(np.arange(0, 1000, SPACING))
    fields = UT * log.orientations.inv().apply(log.field)
    truth = [pose(pair.T_base_target * RigidTransform.from_components(*at))
             for at in zip(log.positions, log.orientations, strict=True)]  # fmt: skip

    rng = np.random.default_rng(0)
    draw = lambda sd: gtsam.Pose3.Expmap(sd * rng.standard_normal(6))  # noqa: E731
    steps = [a.between(b).compose(draw(STEP_SD)) for a, b in pairwise(truth)]
    start = truth[0].compose(draw(START_SD))
    odometry = [start]
    for step in steps:
        odometry.append(odometry[-1].compose(step))

    solver = follow(field_map, start, steps, fields)
    estimate = solver.calculateEstimate()
    solved = [estimate.atPose3(k) for k in range(len(truth))]
    C = solver.marginalCovariance(len(truth) - 1)  # in body axes, rotation first
    print(
        f"{len(truth)} nodes along {sum(np.linalg.norm(s.translation()) for s in steps):.1f} m, one field factor each"
    )
    print("error against the truth, in the map's frame:")
    for name, poses in (("odometry alone", odometry), ("with the field", solved)):
        place, turn = np.array([errors(T, T_true) for T, T_true in zip(poses, truth, strict=True)]).T
        print(f"  {name}: {rms(place):.3f} m and {rms(turn):.1f} deg (rms), {place[-1]:.3f} m at the end")
    print(f"the graph's own statement at the end: {np.sqrt(np.trace(C[3:, 3:])):.3f} m (sd)")


def pose(T: RigidTransform) -> gtsam.Pose3:
    return gtsam.Pose3(T.as_matrix())


def errors(T: gtsam.Pose3, T_true: gtsam.Pose3) -> tuple[float, float]:
    """Distance in m and angle in deg."""
    off = gtsam.Pose3.Logmap(T_true.between(T))
    return float(np.linalg.norm(T.translation() - T_true.translation())), float(np.rad2deg(np.linalg.norm(off[:3])))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
