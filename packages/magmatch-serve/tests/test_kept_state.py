"""What a localizer knows goes on in another process."""

from concurrent.futures import Future

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.errors import DataFormatError
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import KnownPlaces, NotReadyError, open_place
from magmatch.localization.localizer import Localizer
from magmatch.registration.index.atlas import open_atlas
from magmatch.store import dumps, loads
from magmatch_serve.bodies.kept_state import KINDS, SCHEMA, restored, state_of


@pytest.fixture(scope="module")
def known(hall):
    return KnownPlaces(open_place(hall.map))


@pytest.fixture(scope="module")
def log(hall):
    return hall.walk(3, laps=1.5)[0]


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
def test_a_restored_localizer_goes_on_with_the_same_bits(known, log, cut):
    config = LocalizerConfig()
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


def test_a_state_is_no_larger_than_it_says_after_a_long_walk(known, log):
    one = Localizer(known)
    sizes = []
    for k, sample in enumerate(samples(log, range(300))):
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


class Aside:
    """A loader that works when it is told to."""

    def __init__(self):
        self.waiting = []

    def submit(self, do, *arguments):
        self.waiting.append((future := Future(), do, arguments))
        return future

    def work(self):
        for future, do, arguments in self.waiting:
            future.set_result(do(*arguments))
        self.waiting.clear()


def test_a_state_is_resumed_once_its_maps_are_ready(hall, log):
    config = LocalizerConfig()
    one = Localizer(KnownPlaces(open_atlas(hall.folder)), config)
    for sample in samples(log, range(len(log))):
        one.update(*sample)
    aside = Aside()
    known, state = KnownPlaces(open_atlas(hall.folder), aside), written(one)
    with pytest.raises(NotReadyError):
        restored(known, config, loads(state, SCHEMA, KINDS))
    aside.work()
    again = restored(known, config, loads(state, SCHEMA, KINDS)).estimate()
    np.testing.assert_array_equal(again.matrix, one.estimate().matrix)
