# SPDX-License-Identifier: BSD-3-Clause
"""A result states more than its pose: residual, sensor, fitness and the points that agree."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.pose_prior import FAR2
from magmatch.estimation.walk import Walk
from magmatch.geometry import rotate_vectors, rotation_matrix, transform_points
from magmatch.published.fitness import mean_misalignment
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.refine.sensors import TIED_SD
from magmatch.registration.result import NO_LINKS, Links, Sensor
from magmatch.registration.weigh.evidence import PoseEvidence
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence


@dataclass(frozen=True, eq=False, slots=True)
class Support:
    """Figures that support a pose; fields as in `RegistrationResult`."""

    residual: float | None
    n_inliers: int
    links: Links
    sensor: Sensor | None = None
    fitness: float | None = None
    statistics: dict[str, float | None] = field(default_factory=dict)


def support_of_map(
    base: PreparedMap, target: PreparedMap, best: PoseEvidence, T_base_target: RigidTransform
) -> Support:
    """Support of a pose (between surveys) that was weighed by cells."""
    return Support(
        residual=best.residual if np.isfinite(best.residual) else None,
        n_inliers=best.n_good,
        links=_links_of_map(target, T_base_target, best),
        sensor=_sensor(best, target),
        fitness=_fitness(base, target, best),
        statistics={
            "agreeing_share": best.good_share,
            "n_informative": float(best.n_informative),
            "unchanged": best.unchanged,
        },
    )


def support_of_walk(walk: Walk, best: LineEvidence, T_base_target: RigidTransform) -> Support:
    """Support of a pose (between surveys) that was weighed along a walk."""
    p_target = transform_points(walk.positions[best.is_covered], walk.T_survey_walk)
    links = Links(transform_points(p_target, T_base_target), p_target)
    return Support(best.misfit, int(best.is_covered.sum()), links)


def _fitness(base: PreparedMap, target: PreparedMap, best: PoseEvidence) -> float | None:
    T = best.T_base_target
    expected, _, _, is_known = base.raster.lookup(transform_points(target.samples, T))
    aligned = rotate_vectors(best.pose.sensor.correct(target.sample_field), T)
    return mean_misalignment(aligned[is_known], expected[is_known]) if is_known.any() else None


def _sensor(best: PoseEvidence, target: PreparedMap) -> Sensor | None:
    """Estimated difference of the magnetometers in the target's survey axes; None where it was not estimated."""
    sensor = best.pose.sensor
    if best.pose.sensor_sd.max() <= TIED_SD:
        return None
    R = rotation_matrix(target.T_map_model)
    gain = R @ sensor.gain @ R.T
    return {
        "bias": [float(c) for c in R @ sensor.bias],
        # Turning does not change it, but rounds it.
        "scale": float(np.trace(sensor.gain) / 3),
        "gain": [[float(g) for g in row] for row in gain],
        "prior_sd": [float(s) for s in best.pose.sensor_sd],
    }


def _links_of_map(target: PreparedMap, T_base_target: RigidTransform, best: PoseEvidence) -> Links:
    """Distinct target samples that the base explains, and where the answer puts them."""
    if not best.pose.blocks:
        return NO_LINKS
    forward = best.pose.blocks[0]
    rows = np.flatnonzero(forward.residual2 < FAR2)
    p_target = transform_points(forward.positions[rows], target.T_map_model)
    return Links(transform_points(p_target, T_base_target), p_target)
