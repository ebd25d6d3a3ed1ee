# SPDX-License-Identifier: BSD-3-Clause
"""`register`: two surveys (or maps) in, one transform or a refusal with a reason out; `judge`, of poses given."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.arguments import expect_kind, expect_transform, whole_number_of
from magmatch.data.diagnoses import warn
from magmatch.errors import ConfigurationError
from magmatch.progress import Progress, followed
from magmatch.registration.advice import with_advice
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.maps import require_base, require_target, survey_of
from magmatch.registration.provenance import stamped
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import NONE_GIVEN, Given
from magmatch.registration.sensor_calibration import attempted, better_supported, calibrate_sensors
from magmatch.registration.steps import Base, Outcome, Target, register_once
from magmatch.threads import one_blas_thread


def register(
    base: Base, target: Target, config: RegistrationConfig | None = None, *, seed: int = 0
) -> RegistrationResult:
    """Find the transform between two surveys or maps, or say why there is none; folders: `magmatch.register`."""
    return register_keeping_maps(base, target, config, seed=seed)[2]


def judge(
    base: Base,
    target: Target,
    candidates: Sequence[RigidTransform],
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> RegistrationResult:
    """Refine and weigh poses from any source, and decide between them as `register` does, without a search.

    Parameters
    ----------
    base : Survey, FieldMap or MapIndex
        As for `register`; no folder, whose maps have no common frame.
    target : Survey or FieldMap
    candidates : list of RigidTransform
        ``T_base_target``, in any order, each as near as a refinement needs: a fraction of the field's correlation
        length. Of none the result has a status too.
    config : RegistrationConfig, optional
        Preset ``default`` unless given.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    RegistrationResult
        As of `register`. Its probability knows the rivals among the candidates only: if a pose elsewhere fits as
        well, ``register(..., candidates=...)`` finds it.

    Raises
    ------
    TypeError, ValueError
        A candidate that is no rigid transform, or not finite.
    ConfigurationError
        Settings of the published method, which has no posterior.
    """
    with followed(progress):
        return register_keeping_maps(base, target, config, seed=seed, given=given_poses(candidates, is_alone=True))[2]


def given_poses(candidates: Sequence[RigidTransform], *, is_alone: bool = False) -> Given:
    """Check poses from elsewhere."""
    expect_kind(candidates, "candidates", (list, tuple), "give a list of RigidTransform")
    for i, T in enumerate(candidates):
        expect_transform(T, f"candidates[{i}]")
        if not np.isfinite(T.as_matrix()).all():
            msg = f"candidates[{i}]: expected finite numbers, got NaN or infinity; leave it out"
            raise ValueError(msg)
    return Given(tuple(candidates), is_alone=is_alone)


def register_keeping_maps(
    base: Base,
    target: Target,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    given: Given = NONE_GIVEN,
) -> Outcome:
    """Register, and also return base and target as they were used: for pictures, or to keep what was prepared."""
    require_base(base)
    require_target(target)
    config = settings_of(config)
    if config.search == "keypoints" and (given.poses or given.is_alone):
        msg = "candidates: the published method weighs no poses but its own; use the preset 'default'"
        raise ConfigurationError(msg)
    whole_number_of(seed, "seed")
    clock, samples = Clock(), survey_of(target)
    diagnoses = warn((survey_of(base), samples))
    with one_blas_thread():
        outcome = register_once(base, target, samples, config, seed, clock, given)
        # Vectors in a wrong frame are reported at once: no calibration corrects them.
        if config.calibrate and not any(found.is_of_frames for found in diagnoses):
            with clock("calibrate"):
                calibrated = calibrate_sensors(base, outcome, samples)
            if calibrated:
                inputs, sides = calibrated
                outcome = better_supported(
                    outcome, attempted(register_once, *inputs, config, seed, clock, given), sides
                )
    base_used, used, answer = outcome
    answer = with_advice(answer, {"base": survey_of(base), "target": samples}, config.prior)
    return base_used, used, stamped(answer, (survey_of(base), samples), config, seed, clock)
