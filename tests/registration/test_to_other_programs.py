# SPDX-License-Identifier: BSD-3-Clause
"""A registration as TUM row, g2o edge and ROS transform, read by other programs and by definition."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import exp_se3
from magmatch.errors import SurveyError
from magmatch.geometry import adjoint, covariance_about, transform_points
from magmatch.registration.g2o import Edge, g2o_information, write_pose_graph
from magmatch.registration.result import Links, RegistrationResult, Status
from magmatch.registration.to_other_programs import write_g2o, write_relative_tum, write_static_transform

T = RigidTransform.from_components([1.5, -2.0, 0.25], Rotation.from_rotvec([0.3, -0.2, 1.1]))


@pytest.fixture
def covariance():
    rng = np.random.default_rng(2)
    L = np.tril(rng.normal(size=(6, 6))) * np.array([1e-3, 2e-3, 1e-3, 0.01, 0.02, 0.03])[:, None]
    return L @ L.T + 1e-9 * np.eye(6)


@pytest.fixture
def result(covariance):
    return RegistrationResult(Status.ACCEPTED, "fits", T, covariance=covariance)


def error_of_g2o(xi):
    """What g2o computes (toVectorMQT of Z^-1 T_true): translation, then the vector part of the quaternion."""
    delta = T.inv() * (T * exp_se3(xi))
    quaternion = delta.rotation.as_quat(canonical=True)
    return np.concatenate([delta.translation, quaternion[:3]])


def test_information_weighs_an_error_as_the_covariance_does(covariance):
    xi = 1e-6 * np.random.default_rng(1).normal(size=6)
    e = error_of_g2o(xi)
    ours = xi @ np.linalg.solve(covariance, xi)
    assert e @ g2o_information(covariance) @ e == pytest.approx(ours, rel=1e-5)
    delta = exp_se3(xi)
    angle = np.concatenate([delta.translation, delta.rotation.as_rotvec()])
    assert angle @ g2o_information(covariance, "angle") @ angle == pytest.approx(ours, rel=1e-5)


def test_gtsam_reads_the_edge(result, covariance, tmp_path):
    gtsam = pytest.importorskip("gtsam")
    write_g2o(result, tmp_path / "edge.g2o", "angle")
    graph, values = gtsam.readG2o(str(tmp_path / "edge.g2o"), True)
    assert graph.size() == 1
    np.testing.assert_allclose(values.atPose3(1).matrix(), T.as_matrix(), atol=1e-9)
    factor = graph.at(0)
    np.testing.assert_allclose(factor.measured().matrix(), T.as_matrix(), atol=1e-9)
    # GTSAM's tangent is rotation first, as ours.
    np.testing.assert_allclose(factor.noiseModel().covariance(), covariance, rtol=1e-6, atol=1e-14)


def far(result, covariance, base, target):
    """The same registration between frames with far origins; covariance as a result states it, about the origin."""
    p = np.random.default_rng(3).uniform(-2, 2, (20, 3))
    T_far = RigidTransform.from_translation(base) * result.T_base_target * RigidTransform.from_translation(-target)
    M = adjoint(RigidTransform.from_translation(target))
    stated = M @ covariance @ M.T
    return replace(
        result,
        T_base_target=T_far,
        covariance=(stated + stated.T) / 2,
        links=Links(transform_points(p, result.T_base_target) + base, p + target),
    )


def read_g2o(path):
    """Poses and edges of a file that holds nothing else: an independent reader, as strict as Ceres' is."""
    poses, edges = {}, []
    for kind, *words in (line.split() for line in path.read_text().splitlines()):
        n = {"VERTEX_SE3:QUAT": 1, "EDGE_SE3:QUAT": 2}[kind]
        numbers = np.array(words[n:], dtype=float)
        pose = RigidTransform.from_components(numbers[:3], Rotation.from_quat(numbers[3:7]))
        if n == 1:
            poses[int(words[0])] = pose
        else:
            upper = np.zeros((6, 6))
            upper[np.triu_indices(6)] = numbers[7:]
            edges.append((int(words[0]), int(words[1]), pose, upper + np.triu(upper, 1).T))
    return poses, edges


UTM, ECEF, HERE = (691234.5, 5334567.25, 512.0), (4177654.1, 855321.7, 4727811.3), (0.0, 0.0, 0.0)
FAR_FRAMES = [(HERE, ECEF), (UTM, HERE), (HERE, HERE)]


@pytest.mark.parametrize(("base", "target"), FAR_FRAMES)
def test_an_edge_between_far_frames_has_the_information_of_the_near_ones(base, target, result, covariance, tmp_path):
    shown = far(result, covariance, np.array(base), np.array(target))
    write_g2o(shown, tmp_path / "edge.g2o")
    poses, ((first, second, Z, information),) = read_g2o(tmp_path / "edge.g2o")
    assert (first, second) == (0, 1)
    np.testing.assert_allclose((poses[0].inv() * poses[1]).as_matrix(), Z.as_matrix(), atol=1e-8)
    # The target's vertex stands at a whole metre of its frame, within the samples' reach.
    at = shown.T_base_target.inv().apply(poses[1].translation)
    np.testing.assert_allclose(at, np.round(at), atol=1e-8)
    assert np.abs(at - target).max() < 3
    near = covariance_about(covariance, at - target)
    scale = np.sqrt(np.diagonal(near))
    ours = np.linalg.inv(near / np.outer(scale, scale)) / np.outer(scale, scale)
    # g2o's order and half angles, taken back. Stated about 5,000 km, a covariance of (mm, 0.1 deg) is rounded to some
    # 1e-9 m^2, and the least variance here is a few 1e-8 m^2.
    J = np.kron([[0, 1], [1, 0]], np.eye(3)) * np.repeat([1, 0.5], 3)[:, None]
    ratio = np.linalg.eigvals(np.linalg.solve(ours, J.T @ information @ J))
    np.testing.assert_allclose(ratio, 1, rtol=0.1)


def test_a_standard_deviation_is_that_of_the_target_wherever_the_origin_is(result, covariance):
    here = far(result, covariance, np.zeros(3), np.zeros(3)).standard_deviations
    for origin in (UTM, ECEF):
        there = far(result, covariance, np.array(origin), np.array(origin)).standard_deviations
        np.testing.assert_allclose(there, here, rtol=1e-3)


def test_an_edge_of_a_result_is_the_edge_of_a_graph(result, covariance, tmp_path):
    write_g2o(result, tmp_path / "edge.g2o")
    write_pose_graph(tmp_path / "graph.g2o", [RigidTransform.identity(), T], [Edge(0, 1, T, covariance)])
    assert (tmp_path / "edge.g2o").read_bytes() == (tmp_path / "graph.g2o").read_bytes()


def test_relative_tum_is_one_row(result, tmp_path):
    write_relative_tum(result, tmp_path / "T.tum")
    row = np.loadtxt(tmp_path / "T.tum")
    np.testing.assert_array_equal(row, [0, *T.translation, *T.rotation.as_quat()])


def test_static_transform_is_a_transform_message(result, tmp_path):
    write_static_transform(result, tmp_path / "T.yaml", "map", "monday")
    content = yaml.safe_load((tmp_path / "T.yaml").read_text())
    assert (content["header"]["frame_id"], content["child_frame_id"]) == ("map", "monday")
    inner = content["transform"]
    assert list(inner["translation"].values()) == T.translation.tolist()
    assert list(inner["rotation"].values()) == T.rotation.as_quat().tolist()


@pytest.mark.parametrize(
    "write", [write_relative_tum, write_g2o, lambda r, p: write_static_transform(r, p, "a", "b")]
)
def test_nothing_is_written_of_a_refusal(write, tmp_path):
    refused = RegistrationResult(Status.AMBIGUOUS, "two places look alike", None)
    with pytest.raises(SurveyError, match="not accepted"):
        write(refused, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_edge_needs_a_covariance(tmp_path):
    with pytest.raises(SurveyError, match="no covariance"):
        write_g2o(RegistrationResult(Status.ACCEPTED, "fits", T), tmp_path / "edge.g2o")
