"""What a localizer knows goes on in another process."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.kept_state import KINDS, SCHEMA, restored, state_of
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.localizer import Localizer
from magmatch.store import dumps, loads


@pytest.fixture(scope="module")
def known(place):
    return KnownPlaces(place)


def same(a, b):
    if a.T_map_body is None or b.T_map_body is None:
        return (a.T_map_body, a.status, a.probability) == (b.T_map_body, b.status, b.probability)
    return np.array_equal(a.T_map_body.as_matrix(), b.T_map_body.as_matrix()) and np.array_equal(
        a.covariance, b.covariance
    )


def written(localizer):
    return dumps(SCHEMA, state_of(localizer))


def test_a_restored_localizer_goes_on_with_the_same_bits(known, followed, feed):
    log, config = followed.log, LocalizerConfig()
    one, at = Localizer(known, config), 0
    for cut in (1, 60, 200):
        feed(one, log, slice(at, cut))
        other = restored(known, config, loads(written(one), SCHEMA, KINDS))
        assert same(one.estimate(), other.estimate())
        at = cut + 30
        assert all(map(same, *(feed(each, log, slice(cut, at)) for each in (one, other))))
        assert written(one) == written(other)


def test_what_is_looked_for_while_a_body_is_outside_goes_on_too(known, followed, feed):
    config, log = LocalizerConfig(), followed.log.subset(np.arange(150))
    one, R = Localizer(known, config), log.orientations
    feed(one, log)
    # The odometry goes sideways out of the map, where the field is what it was on the way.
    k = np.arange(1, 80)
    positions = log.positions[-1] + R[-1].apply(-0.1 * k[:, None] * [0.0, 1.0, 0.0])
    field = R[-1].apply(R[k].inv().apply(log.field[k]))
    ahead = Survey(positions, field, log.times[-1] + 0.1 * k, Rotation.concatenate([R[-1]] * len(k)))
    feed(one, ahead, slice(0, 50))
    assert one._anew is not None
    other = restored(known, config, loads(written(one), SCHEMA, KINDS))
    assert all(map(same, *(feed(each, ahead, slice(50, None)) for each in (one, other))))
    assert written(one) == written(other)


def test_a_state_is_no_larger_than_it_says_after_a_long_walk(known, followed, feed):
    one, sizes = Localizer(known), []
    for rows in (slice(0, 100), slice(100, 200), slice(200, 300)):
        feed(one, followed.log, rows)
        sizes.append(len(written(one)))
    assert sizes[-1] < 2 * sizes[0]
    assert sizes[-1] < 500_000


def test_a_state_of_other_settings_is_refused(known):
    state = state_of(Localizer(known))
    with pytest.raises(DataFormatError, match="other settings"):
        restored(known, LocalizerConfig(window=9.0), state)
    with pytest.raises(DataFormatError, match="of version"):
        restored(known, LocalizerConfig(), state | {"written_by": [SCHEMA, "0.0"]})


def test_hypotheses_are_the_estimate_s(known, followed, feed):
    one = Localizer(known)
    now, found = feed(one, followed.log, slice(0, 150))[-1], one.hypotheses()
    assert found[0].probability == now.probability
    assert np.linalg.norm(found[0].T_map_body.translation - now.T_map_body.translation) < 0.3
    assert sum(h.probability for h in found) <= 1 + 1e-9
