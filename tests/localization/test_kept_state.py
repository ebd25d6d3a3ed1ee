"""What a localizer knows goes on in another process."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.errors import DataFormatError
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.kept_state import KINDS, SCHEMA, restored, state_of
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.localizer import Localizer
from magmatch.store import dumps, loads


@pytest.fixture(scope="module")
def known(place):
    return KnownPlaces(place)


def samples(log, rows):
    field = log.orientations.inv().apply(log.field)
    for n in rows:
        T = RigidTransform.from_components(log.positions[n], log.orientations[n])
        yield float(log.times[n]), T, field[n]


def same(a, b):
    if a.T_map_body is None or b.T_map_body is None:
        return (a.T_map_body, a.status, a.probability) == (b.T_map_body, b.status, b.probability)
    return np.array_equal(a.T_map_body.as_matrix(), b.T_map_body.as_matrix()) and np.array_equal(
        a.covariance, b.covariance
    )


def written(localizer):
    return dumps(SCHEMA, state_of(localizer))


@pytest.mark.parametrize("cut", [1, 12, 60, 200])
def test_a_restored_localizer_goes_on_with_the_same_bits(known, followed, cut):
    log, config = followed.log, LocalizerConfig()
    one = Localizer(known, config)
    for sample in samples(log, range(cut)):
        one.update(*sample)
    other = restored(known, config, loads(written(one), SCHEMA, KINDS))
    assert same(one.estimate(), other.estimate())
    for sample in samples(log, range(cut, min(cut + 60, len(log)))):
        one.update(*sample)
        other.update(*sample)
        assert same(one.estimate(), other.estimate())
    assert written(one) == written(other)


def test_what_is_looked_for_while_a_body_is_outside_goes_on_too(known, followed):
    config, log = LocalizerConfig(), followed.log
    one = Localizer(known, config)
    fed = list(samples(log, range(150)))
    # The odometry goes sideways out of the map, where the field is what it was on the way.
    t, T, _ = fed[-1]
    ahead = [(t + 0.1 * k, T * RigidTransform.from_translation([0, -0.1 * k, 0]), fed[k][2]) for k in range(1, 80)]
    for sample in [*fed, *ahead[:50]]:
        one.update(*sample)
    assert one._anew is not None
    other = restored(known, config, loads(written(one), SCHEMA, KINDS))
    for sample in ahead[50:]:
        one.update(*sample)
        other.update(*sample)
        assert same(one.estimate(), other.estimate())
    assert written(one) == written(other)


def test_a_state_is_no_larger_than_it_says_after_a_long_walk(known, followed):
    one = Localizer(known)
    sizes = []
    for k, sample in enumerate(samples(followed.log, range(300))):
        one.update(*sample)
        if k % 100 == 99:
            sizes.append(len(written(one)))
    assert sizes[-1] < 2 * sizes[0]
    assert sizes[-1] < 500_000


def test_a_state_of_other_settings_is_refused(known):
    state = state_of(Localizer(known))
    with pytest.raises(DataFormatError, match="other settings"):
        restored(known, LocalizerConfig(window=9.0), state)
    with pytest.raises(DataFormatError, match="of version"):
        restored(known, LocalizerConfig(), state | {"written_by": [SCHEMA, "0.0"]})


def test_hypotheses_are_the_estimate_s(known, followed):
    one = Localizer(known)
    for sample in samples(followed.log, range(150)):
        one.update(*sample)
    now, found = one.estimate(), one.hypotheses()
    assert found[0].probability == now.probability
    assert np.linalg.norm(found[0].T_map_body.translation - now.T_map_body.translation) < 0.3
    assert sum(h.probability for h in found) <= 1 + 1e-9
