# SPDX-License-Identifier: BSD-3-Clause
"""A pair of surveys of one known field, their maps, and results without running a registration."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE
from magmatch.field.map import FieldMap
from magmatch.geometry import transform_points
from magmatch.registration.result import Alternative, DegenerateDirection, Links, RegistrationResult, Status


@dataclass(frozen=True)
class Pair:
    base: Survey
    target: Survey
    base_map: FieldMap
    target_map: FieldMap
    accepted: RegistrationResult
    refused: RegistrationResult


def field_of_a_magnet(p):
    return dipoles(p, [[1.0, 1.0, -1.0]], [[0.0, 4e-6, 1e-5]]) + np.array([2e-5, 0, -4e-5])


@pytest.fixture(scope="session")
def pair() -> Pair:
    rng = np.random.default_rng(0)
    T = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_euler("zx", [40, 10], degrees=True))
    p = rng.uniform(0, 2, (400, 3)) * [1, 1, 0.3]
    base = Survey(p[:200], field_of_a_magnet(p[:200]), times=np.arange(200.0), name="base.csv")
    target = replace(Survey(p[200:], field_of_a_magnet(p[200:])).transformed(T.inv()), name="target.csv")
    p_links = p[::40]
    accepted = RegistrationResult(
        status=Status.ACCEPTED,
        reason="10 of 10 cells agree",
        T_base_target=T,
        covariance=np.diag([1e-4] * 6),
        probability=0.997,
        overlap=0.9,
        alternatives=(Alternative(T.inv(), 0.002),),
        sensor={"bias": [1e-7, 0.0, 0.0], "scale": 1.001},
        residual=1.02,
        n_inliers=10,
        links=Links(p_links, transform_points(p_links, T.inv())),
        seconds={"search": 0.5, "total": 1.0},
        config={"search": "invariants"},
        version="0.1.0",
        inputs=({"name": "base.csv", "sha256": "aa"}, {"name": "target.csv", "sha256": "bb"}),
    )
    refused = replace(
        accepted,
        status=Status.DEGENERATE,
        reason="the data leave a direction free",
        T_base_target=None,
        covariance=None,
        probability=0.4,
        degenerate_directions=(DegenerateDirection(np.eye(6)[3], "sliding along base x"),),
    )
    return Pair(base, target, build_map(base, SPLINE), build_map(target, SPLINE), accepted, refused)


@pytest.fixture(scope="session")
def report(pair, tmp_path_factory) -> Path:
    """The page of the registration that is accepted."""
    pytest.importorskip("plotly")
    from magmatch.viz.pages.registration_page import write_report

    path = tmp_path_factory.mktemp("report") / "r.html"
    write_report(path, pair.base_map, pair.target_map, pair.accepted)
    return path
