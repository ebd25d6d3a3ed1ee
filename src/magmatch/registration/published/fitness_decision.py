# SPDX-License-Identifier: BSD-3-Clause
"""The published decision: a consensus is accepted if the aligned vectors' fitness is below a threshold."""

from pydantic import Field

from magmatch.registration.decide.decision import Verdict
from magmatch.registration.decide.fitness import Fitness
from magmatch.registration.result import Alternative, RegistrationResult, Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.settings import Settings


class FitnessConfig(Settings):
    """When a consensus is accepted."""

    # Least share of the samples inside the base map.
    min_overlap: float = Field(default=0.05, ge=0, le=1)
    # Largest mean sine-weighted misalignment of aligned vectors (see fitness.py).
    max_fitness: float = Field(default=0.1, gt=0)


def by_fitness(found: SearchResult, fitness: Fitness | None, config: FitnessConfig) -> RegistrationResult:
    """State the best consensus of a search in survey frames, judged by its fitness (None: no pose was found)."""
    overlap = fitness.overlap if fitness else 0.0
    value = fitness.value if fitness else None
    verdict = decide_by_fitness(value, overlap, config)
    is_accepted = verdict.status is Status.ACCEPTED
    return RegistrationResult(
        status=verdict.status,
        reason=verdict.reason,
        T_base_target=found.poses[0] if is_accepted else None,
        overlap=overlap,
        alternatives=() if is_accepted else tuple(Alternative(T) for T in found.poses),
        fitness=value,
        n_inliers=found.n_inliers,
        n_keypoints=found.n_keypoints,
        n_correspondences=found.n_correspondences,
        links=found.links,
    )


def decide_by_fitness(fitness: float | None, overlap: float, config: FitnessConfig) -> Verdict:
    """Compare the fitness (None: no pose, or nothing overlaps) with its threshold."""
    if fitness is None:
        return Verdict(Status.UNINFORMATIVE, "too few matching keypoints for a pose; survey closer to iron")
    if overlap < config.min_overlap:
        return Verdict(Status.NO_OVERLAP, f"only {overlap:.0%} of the target falls inside the base map")
    if fitness > config.max_fitness:
        return Verdict(
            Status.INCONSISTENT,
            f"fitness {fitness:.3g} is above {config.max_fitness:.3g}: aligned vectors do not agree",
        )
    return Verdict(Status.ACCEPTED, f"fitness {fitness:.3g} is below {config.max_fitness:.3g}")
