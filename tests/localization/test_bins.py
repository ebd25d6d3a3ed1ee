# SPDX-License-Identifier: BSD-3-Clause
"""A bin's pose and field are means of its samples'."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.localization.bins import Binning
from magmatch.localization.samples import LastSample

SIDE = 0.1


def bins_of(times, poses, fields):
    """Bins that are complete, of samples along a path."""
    samples, binning = LastSample(), Binning(SIDE)
    for t, T, z in zip(times, poses, fields, strict=True):
        done = binning.add(samples.take(float(t), T.as_matrix(), z))
        if done is not None:
            yield done[0]


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 9), wobble=st.floats(0, 0.5))
def test_a_bin_is_the_mean_of_its_samples(seed, n, wobble):
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng) * Rotation.from_rotvec(rng.normal(0, wobble, (n, 3)))
    places = np.cumsum(rng.uniform(0, SIDE / 20, (n, 3)), axis=0)
    times, field = 0.1 * np.arange(n + 1), 4e-5 * rng.standard_normal((n + 1, 3))
    # The sample that lies farther off than a side completes the bin.
    R, places = Rotation.concatenate([R, R[0]]), np.vstack([places, places[-1] + SIDE * np.ones(3)])
    (done,) = bins_of(times, RigidTransform.from_components(places, R), field)
    mean = R[:n].mean()
    np.testing.assert_allclose(done["t"], times[:n].mean())
    np.testing.assert_allclose(done["p"], places[:n].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(done["R"], mean.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(done["z"], mean.inv().apply(R[:n].apply(field[:n]).mean(axis=0)), atol=1e-13)
    # A bias of the sensor, in the body's axes, moves the mean field so.
    bias = rng.standard_normal(3)
    moved = mean.inv().apply(R[:n].apply(bias).mean(axis=0)) if n > 1 else bias
    np.testing.assert_allclose(done["M"] @ bias, moved.reshape(3), atol=1e-9)
