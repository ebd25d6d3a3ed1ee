"""Maps whose field is known exactly: a few dipoles outside the surveyed box."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import rotate_vectors, transform_points

EARTH = np.array([18e-6, 3e-6, -45e-6])


@dataclass(frozen=True, eq=False)
class Dipoles:
    """Field and gradient of point dipoles plus the Earth's field, T."""

    positions: np.ndarray
    moments: np.ndarray  # uT m^3

    def field(self, x):
        return dipoles(x, self.positions, 1e-6 * self.moments) + EARTH

    def gradient(self, x, step=1e-4):
        shifts = step * np.eye(3)
        return np.stack([(self.field(x + s) - self.field(x - s)) / (2 * step) for s in shifts], axis=2)


@dataclass(frozen=True, eq=False)
class ExactPosterior:
    """A posterior that knows the truth: weights are a constant field added to it."""

    source: Dipoles
    T_world_model: RigidTransform
    low: np.ndarray
    high: np.ndarray
    hyperparameters: Hyperparameters

    def evaluate(self, points, order=0, weights=None):
        x = transform_points(points, self.T_world_model)
        values = FieldValues(self.source.field(x), self.source.gradient(x) if order else None)
        values = values.rotated(self.T_world_model.inv())
        extra = 0.0 if weights is None else weights
        return FieldValues(values.field + extra, values.gradient)

    def covariance(self, points, order=0):
        size = 3 if order == 0 else 12
        return np.tile(1e-14 * np.eye(size), (len(points), 1, 1))

    def influence(self, points):
        # Of the constant field, in units of the noise.
        return np.kron(np.ones((len(points), len(points))), 1e-14 / self.hyperparameters.noise_sd**2 * np.eye(3))

    def draw_weights(self, n_draws, rng):
        return 1e-7 * rng.standard_normal((n_draws, 3))

    def knows(self, points):
        return np.all((points > self.low - 0.2) & (points < self.high + 0.2), axis=1)


def exact_map(source, survey, T_world_survey, noise_sd=0.3e-6):
    """A map of a survey that was taken in a world of known sources."""
    T_survey_model = survey.principal_frame()
    model = survey.transformed(T_survey_model.inv()).positions
    numbers = Hyperparameters(0.6, 15e-6, noise_sd, 0.2)
    posterior = ExactPosterior(source, T_world_survey * T_survey_model, model.min(axis=0), model.max(axis=0), numbers)
    return FieldMap(survey, posterior, T_survey_model, FieldConfig(prior="spline"), T_survey_model)


def room_of_dipoles(seed, n=40):
    """Dipoles around, not inside, a box of 3 x 3 x 0.6 m."""
    rng = np.random.default_rng(seed)
    box = np.array([3.0, 3.0, 0.6])
    p = rng.uniform([-1, -1, -1], box + 1, size=(40 * n, 3))
    p = p[np.linalg.norm(p - np.clip(p, 0, box), axis=1) > 0.35][:n]
    return Dipoles(p, rng.normal(size=(n, 3)) * 3.0)


def survey_of(source, rng, T_world_survey, n=800, noise_sd=0.3e-6):
    x = rng.uniform(0, [3.0, 3.0, 0.6], size=(n, 3))
    b = source.field(x) + noise_sd * rng.standard_normal((n, 3))
    T = T_world_survey.inv()
    return Survey(transform_points(x, T), rotate_vectors(b, T))


@pytest.fixture(scope="session")
def make_exact_pair():
    """Build (base map, target map, T_base_target) of one room, or of two different ones."""

    def make(seed, T_base_target, other_room=False):
        rng = np.random.default_rng(seed)
        source = room_of_dipoles(seed)
        other = room_of_dipoles(seed + 1000) if other_room else source
        identity = RigidTransform.identity()
        base = exact_map(source, survey_of(source, rng, identity), identity)
        target = exact_map(other, survey_of(other, rng, T_base_target), T_base_target)
        return base, target

    return make


@pytest.fixture(scope="session")
def make_moved_pair():
    """Build (base map, target map, what the field changed by) of a room whose strongest dipoles moved in between."""

    def make(seed, T_base_target, n_moved):
        rng = np.random.default_rng(seed)
        before = room_of_dipoles(seed)
        samples = rng.uniform(0, [3.0, 3.0, 0.6], size=(300, 3))
        alone = (Dipoles(before.positions[[k]], before.moments[[k]]) for k in range(len(before.positions)))
        pull = [np.abs(one.field(samples) - EARTH).max() for one in alone]
        chosen = np.argsort(pull)[-n_moved:]
        positions = before.positions.copy()
        box = np.array([3.0, 3.0, 0.6])
        for k in chosen:
            outward = positions[k] - np.clip(positions[k], 0, box)
            positions[k] += 0.5 * np.cross(outward, [0.3, 0.5, 0.8]) / np.linalg.norm(outward) + 0.1 * outward
        after = Dipoles(positions, before.moments)
        identity = RigidTransform.identity()
        base = exact_map(before, survey_of(before, rng, identity), identity)
        target = exact_map(after, survey_of(after, rng, T_base_target), T_base_target)
        return base, target, lambda x: after.field(x) - before.field(x)

    return make
