# SPDX-License-Identifier: BSD-3-Clause
"""Methods that only refine a start: this package's dense refinement alone, and GICP on surfaces of equal |B|."""

import numpy as np
import small_gicp
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import RigidTransform

from magmatch.field.map import FieldMap
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.map_strategy import MapStrategy
from magmatch.registration.refine.refinement import refine
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.steps import Weighed, settle_and_decide
from magmatch.registration.weigh.cells import null_models_of
from magmatch.registration.weigh.evidence import weigh_pose
from magmatch_evaluation.baselines.judged import judged
from magmatch_evaluation.baselines.volume import level_points, magnitude_volume, shared_spacing


class GicpConfig(BaseModel):
    """Surfaces of equal |B| as point clouds, and how GICP aligns them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Levels, as quantiles of the magnitude at both surveys' samples.
    levels: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)
    # Grid points in one lengthscale, and most points of a grid.
    points_per_lengthscale: float = Field(default=8.0, gt=0)
    max_points: int = Field(default=400_000, ge=1000)
    # Farthest partner of a point, lengthscales; the last of the passes has the last.
    reach: tuple[float, ...] = (0.8, 0.4, 0.2)
    max_iterations: int = Field(default=50, ge=1)


def register_by_refinement(
    base_map: FieldMap, target_map: FieldMap, start: RigidTransform, config: RegistrationConfig, seed: int
) -> RegistrationResult:
    """Refine one start against the field and judge it as this package's registration does: no search."""
    clock = Clock()
    strategy = MapStrategy.of(target_map, config, seed, clock)
    pair = strategy.pair(prepare_index(base_map))
    T_model, rng = pair.T_base_model.inv() * start * pair.T_target_model, np.random.default_rng(seed)
    pose = refine(pair.base, pair.target, T_model, pair.prior, strategy.sensors, rng)
    evidence = weigh_pose(pair.base, pair.target, pose, null_models_of(pair.base, pair.target), pair.prior)
    return settle_and_decide(Weighed(strategy, pair, SearchResult((T_model,)), [evidence]), config.decision, clock)


def register_by_gicp(
    base_map: FieldMap,
    target_map: FieldMap,
    start: RigidTransform,
    config: GicpConfig,
    seed: int,  # noqa: ARG001
) -> RegistrationResult:
    """Align surfaces of equal |B| by GICP from a rough start.

    References
    ----------
    K. Koide, small_gicp: Efficient and parallel algorithms for point cloud registration, JOSS 9(100), 2024.
    """
    spacing = shared_spacing(base_map, target_map, config.points_per_lengthscale, config.max_points)
    volumes = [magnitude_volume(m, spacing) for m in (base_map, target_map)]
    measured = np.concatenate([np.linalg.norm(m.survey.field, axis=1) for m in (base_map, target_map)])
    levels = np.quantile(measured, config.levels)
    clouds = [np.concatenate([level_points(v, float(level)) for level in levels]) for v in volumes]
    if min(map(len, clouds)) < 20:
        return judged(base_map, target_map, None)
    T, length = start, min(m.hyperparameters.lengthscale for m in (base_map, target_map))
    for reach in config.reach:
        answer = small_gicp.align(
            *clouds, T.as_matrix(), registration_type="GICP", downsampling_resolution=spacing,
            max_correspondence_distance=reach * length, max_iterations=config.max_iterations,
        )  # fmt: skip
        T = RigidTransform.from_matrix(np.array(answer.T_target_source))
    return judged(base_map, target_map, T, n_correspondences=len(clouds[1]), n_inliers=int(answer.num_inliers))
