# SPDX-License-Identifier: BSD-3-Clause
"""`register`: surveys or maps in, one transform or a refusal with a reason out; `judge`: the same, of poses given."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch._version import __version__
from magmatch.arguments import expect_kind, expect_transform, whole_number_of
from magmatch.data.diagnoses import warn
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.data.tables.text import is_folder
from magmatch.errors import ConfigurationError
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, followed
from magmatch.registration.advice import with_advice
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.index.atlas import Atlas, open_atlas
from magmatch.registration.index.map_index import MapIndex
from magmatch.registration.maps import require_base, require_target, survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.registration.search.candidate import NONE_GIVEN, Given
from magmatch.registration.sensor_calibration import attempted, better_supported, calibrate_sensors
from magmatch.registration.steps import Base, Outcome, Target, register_once
from magmatch.registration.vertical_offset import with_vertical_offset
from magmatch.threads import one_blas_thread


def register(
    base: Base | str | Path,
    target: Target,
    config: RegistrationConfig | None = None,
    *,
    candidates: Sequence[RigidTransform] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> RegistrationResult:
    """Find the rigid transform between two magnetic surveys of one place, or say why there is none.

    Parameters
    ----------
    base : Survey, FieldMap, MapIndex, Atlas or path of a folder of saved maps
        Defines the frame; a survey is mapped first. For many targets, pass the base as a `MapIndex`. With many maps,
        the result's ``base`` names the one that contains the target, and its probability allows for all of them.
    target : Survey or FieldMap
        In its own frame.
    config : RegistrationConfig, optional
        Preset ``default`` unless given; ``PRESETS["paper"]`` is the published method, ``"paper-literal"`` the same to
        the letter. An `Atlas` has its own.
    candidates : list of RigidTransform, optional
        Poses ``T_base_target`` from elsewhere (another matcher, GNSS), weighed beside those that are found.
    seed : int
        Same input, configuration and seed give the same answer bit for bit.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.

    Returns
    -------
    RegistrationResult
        ``T_base_target`` is None unless accepted; ``reason`` says why.

    Raises
    ------
    SurveyError
        A survey holds NaN, impossible values or too few samples.
    TypeError
        Neither surveys nor maps; says how to convert what was given.
    """
    with followed(progress):
        return register_keeping_maps(base, target, config, seed=seed, given=given_poses(candidates))[2]


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
    base: Base | str | Path,
    target: Target,
    config: RegistrationConfig | None = None,
    *,
    seed: int = 0,
    given: Given = NONE_GIVEN,
) -> tuple[FieldMap | MapIndex | None, Target, RegistrationResult]:
    """Register, and also return base and target as they were used: for pictures, or to keep what was prepared.

    There is no base where none of many maps holds a pose.
    """
    base, config = _opened(base, target, config)
    if config.search == "keypoints" and (given.poses or given.is_alone):
        msg = "candidates: the published method weighs no poses but its own; use the preset 'default'"
        raise ConfigurationError(msg)
    if config.search == "keypoints" and (config.prior, config.decision) != (PosePriorConfig(), DecisionConfig()):
        msg = (
            "what is known of the pose, and what is asked for (--prior-pose, --gravity-aligned, --planar, --max-sd, "
            "--min-probability): these settings search by keypoints, which use none of it; use the preset 'default'"
        )
        raise ConfigurationError(msg)
    whole_number_of(seed, "seed")
    # A folder of one map is that map; its name is that of the file.
    only = base.entries[0] if isinstance(base, Atlas) and len(base.entries) == 1 else None
    if only is not None and isinstance(base, Atlas):
        base = base.load(only)
    if isinstance(base, Atlas) and (given.poses or given.is_alone):
        msg = "candidates: poses in which of many maps? give one map as the base"
        raise ConfigurationError(msg)
    clock, samples = Clock(), survey_of(target)
    known = [samples] if isinstance(base, Atlas) else [survey_of(base), samples]
    diagnoses = warn(known)
    with one_blas_thread():
        outcome = register_once(base, target, samples, config, seed, clock, given)
        # Vectors in a wrong frame are reported at once: no correction of the sensors helps them.
        if config.calibrate and not any(found.is_of_frames for found in diagnoses):

            def look(base: Base, target: Target, samples: Survey, log_prior: float = 0.0) -> Outcome | None:
                asked = config.with_log_prior(log_prior)
                return attempted(register_once, base, target, samples, asked, seed, clock, given)

            outcome = _with_sensors_corrected(outcome, base, samples, config, look, clock)
    base_used, used, answer = outcome
    has_pose = answer.best_pose is not None
    if only is not None:
        answer = replace(answer, base=only.name if has_pose else None)
    elif isinstance(base, Atlas) and has_pose:
        known = [survey_of(base_used), samples]
    surveys = dict(zip(("base", "target")[-len(known) :], known, strict=True))
    answer = with_advice(answer, surveys, config.prior)
    is_found = has_pose or not (only or isinstance(base, Atlas))
    return base_used if is_found else None, used, _stamped(answer, known, config, seed, clock)


def _with_sensors_corrected(
    outcome: Outcome,
    base: Base,
    samples: Survey,
    config: RegistrationConfig,
    look: Callable[..., Outcome | None],
    clock: Clock,
) -> Outcome:
    """The outcome of another look with corrected sensors, where that is likelier, or else the one given."""
    with clock("calibrate"):
        calibrated = calibrate_sensors(base, outcome, samples)
    if calibrated:
        inputs, sides = calibrated
        outcome = better_supported(outcome, look(*inputs), sides)
    may_differ = config.prior.is_upright and config.refinement.sensor.mode != "none"
    return with_vertical_offset(outcome, look) if may_differ and not isinstance(base, Atlas) else outcome


def _stamped(
    answer: RegistrationResult, inputs: Sequence[Survey], config: RegistrationConfig, seed: int, clock: Clock
) -> RegistrationResult:
    """An answer with what is needed to repeat the run and get the same numbers."""
    return replace(
        answer,
        seconds=clock.seconds(),
        config=config.model_dump(mode="json"),
        version=__version__,
        seed=seed,
        inputs=tuple(describe_input(survey) for survey in inputs),
    )


def _opened(
    base: Base | str | Path, target: Target, config: RegistrationConfig | None
) -> tuple[Base, RegistrationConfig]:
    """Check base and target, and open a folder of maps; many maps have settings of their own."""
    if isinstance(base, str | os.PathLike) and is_folder(base):
        require_target(target)
        base, config = open_atlas(base, config), None
    require_base(base)
    require_target(target)
    assert not isinstance(base, str | Path)  # other paths are refused
    if not isinstance(base, Atlas):
        return base, settings_of(config)
    if config is not None and config != base.config:
        msg = (
            "config: expected that of the Atlas, or none, got another; open_atlas(folder, config) opens it with this"
        )
        raise ConfigurationError(msg)
    return base, base.config
