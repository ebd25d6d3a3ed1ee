"""The dense refinement's likelihood against finite differences."""

import numpy as np

from magmatch.registration.prepared.drift import Drift
from magmatch.registration.refine.refinement import STUDENT_DOF, Lookup, _residual_block
from magmatch.registration.refine.sensors import SensorConfig, identical_sensors


def test_curvature_is_that_of_the_student_likelihood():
    """Against finite differences, averaged over directions; a large residual bends it less than its weight says."""
    rng = np.random.default_rng(3)
    residual = rng.normal(0, 0.5, (40, 3))
    residual[:4] *= 15
    zeros, noise_sd = np.zeros((40, 3)), 2.0  # the residuals' variance is then a quarter of the noise's: 1
    lookup = Lookup(np.arange(40), zeros, zeros, residual, np.tile(np.eye(3), (40, 1, 1)), zeros, np.zeros(40))
    none = Drift(0.0, 0.0, np.zeros(40, dtype=np.int64), np.zeros((1, 1)))
    found = _residual_block(lookup, noise_sd, none, np.zeros(3), identical_sensors(SensorConfig(mode="none"), -1))

    def loss(r):
        return 0.5 * (STUDENT_DOF + 3) * np.log1p((r**2).sum(axis=-1) / STUDENT_DOF)

    h = 1e-4
    bends = sum(loss(residual + h * e) + loss(residual - h * e) - 2 * loss(residual) for e in np.eye(3)) / (3 * h**2)
    np.testing.assert_allclose(found.curvature[3:6, 3:6], bends.sum() * np.eye(3), rtol=1e-6)
    assert found.curvature[3, 3] < found.information[3, 3]
