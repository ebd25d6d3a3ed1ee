# SPDX-License-Identifier: BSD-3-Clause
"""`register`: two surveys (or maps) in, one transform or a refusal with a reason out."""

from magmatch.arguments import whole_number_of
from magmatch.data.diagnoses import warn
from magmatch.registration.advice import with_advice
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig, settings_of
from magmatch.registration.maps import require_base, require_target, survey_of
from magmatch.registration.provenance import stamped
from magmatch.registration.result import RegistrationResult
from magmatch.registration.sensor_calibration import attempted, better_supported, calibrate_sensors
from magmatch.registration.steps import Base, Outcome, Target, register_once
from magmatch.threads import one_blas_thread


def register(
    base: Base, target: Target, config: RegistrationConfig | None = None, *, seed: int = 0
) -> RegistrationResult:
    """Find the transform between two surveys or maps, or say why there is none; folders: `magmatch.register`."""
    return register_keeping_maps(base, target, config, seed=seed)[2]


def register_keeping_maps(
    base: Base, target: Target, config: RegistrationConfig | None = None, *, seed: int = 0
) -> Outcome:
    """Register, and also return base and target as they were used: for pictures, or to keep what was prepared."""
    require_base(base)
    require_target(target)
    config = settings_of(config)
    whole_number_of(seed, "seed")
    clock, samples = Clock(), survey_of(target)
    diagnoses = warn((survey_of(base), samples))
    with one_blas_thread():
        outcome = register_once(base, target, samples, config, seed, clock)
        # Vectors in a wrong frame are reported at once: no calibration corrects them.
        if config.calibrate and not any(found.is_of_frames for found in diagnoses):
            with clock("calibrate"):
                calibrated = calibrate_sensors(base, outcome, samples)
            if calibrated:
                inputs, sides = calibrated
                outcome = better_supported(outcome, attempted(register_once, *inputs, config, seed, clock), sides)
    base_used, used, answer = outcome
    answer = with_advice(answer, {"base": survey_of(base), "target": samples}, config.prior)
    return base_used, used, stamped(answer, (survey_of(base), samples), config, seed, clock)
