# SPDX-License-Identifier: BSD-3-Clause
"""Maps that know the truth: dipoles around a box, with analytic derivatives up to the second."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import rotate_vectors, transform_points

EARTH = np.array([18e-6, 3e-6, -45e-6])
BOX = np.array([2.4, 2.0, 0.6])
I3 = np.eye(3)
NUMBERS = Hyperparameters(0.6, 15e-6, 0.3e-6, 0.2)


@dataclass(frozen=True, eq=False)
class Dipoles:
    """B_a = m_b d_ab (1/r), so every derivative is one of 1/r."""

    positions: np.ndarray
    moments: np.ndarray  # T m^3
    background: np.ndarray

    def values(self, x, order):
        total = [np.tile(self.background, (len(x), 1)), np.zeros((len(x), 3, 3)), np.zeros((len(x), 3, 3, 3))]
        for p, m in zip(self.positions, self.moments, strict=True):
            r = x - p
            d = np.linalg.norm(r, axis=1)
            u = r @ m
            total[0] += (3 * u / d**5)[:, None] * r - m / (d**3)[:, None]
            if order > 0:
                rr = r[:, :, None] * r[:, None, :]
                mr = m[:, None] * r[:, None, :]
                linear = mr + np.swapaxes(mr, 1, 2) + u[:, None, None] * I3
                total[1] += 3 * linear / (d**5)[:, None, None] - (15 * u / d**7)[:, None, None] * rr
            if order > 1:
                total[2] += second_derivative(r, m, d)
        return FieldValues(total[0], total[1] if order > 0 else None, total[2] if order > 1 else None)


def second_derivative(r, m, d):
    u = r @ m
    rrr = np.einsum("na,nb,nc->nabc", r, r, r)
    s = np.einsum("a,nb,nc->nabc", m, r, r)
    s = s + np.einsum("b,na,nc->nabc", m, r, r) + np.einsum("c,na,nb->nabc", m, r, r)
    e = np.einsum("ab,nc->nabc", I3, r) + np.einsum("ac,nb->nabc", I3, r) + np.einsum("bc,na->nabc", I3, r)
    f = np.einsum("ab,c->abc", I3, m) + np.einsum("ac,b->abc", I3, m) + np.einsum("bc,a->abc", I3, m)
    wide = (slice(None), None, None, None)
    return 105 * (u / d**9)[wide] * rrr - 15 * (s + u[wide] * e) / (d**7)[wide] + 3 * f / (d**5)[wide]


@dataclass(frozen=True, eq=False)
class TruePosterior:
    """Says what the sources say, in a model frame; variance grows along the model's x."""

    source: Dipoles
    T_world_model: RigidTransform
    low: np.ndarray
    high: np.ndarray
    hyperparameters: Hyperparameters

    def evaluate(self, points, order=0, weights=None):
        x = transform_points(points, self.T_world_model)
        return self.source.values(x, order).rotated(self.T_world_model.inv())

    def covariance(self, points, order=0):
        return 1e-14 * (2 + points[:, 0] / self.high[0])[:, None, None] * I3

    def knows(self, points):
        return np.all((points > self.low - 0.1) & (points < self.high + 0.1), axis=1)


def dipole_room(seed, n=30):
    """Dipoles 0.35 m or more outside a box."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, BOX + 1, size=(40 * n, 3))
    p = p[np.linalg.norm(p - np.clip(p, 0, BOX), axis=1) > 0.35][:n]
    return Dipoles(p, 3e-6 * rng.normal(size=(n, 3)), EARTH)


def true_map(source, survey, T_world_survey):
    """Map of a survey taken in a world of known sources."""
    T_survey_model = survey.principal_frame()
    model = survey.transformed(T_survey_model.inv()).positions
    posterior = TruePosterior(source, T_world_survey * T_survey_model, model.min(axis=0), model.max(axis=0), NUMBERS)
    return FieldMap(survey, posterior, T_survey_model, FieldConfig(prior="spline"), T_survey_model)


def survey_in(source, x, T_world_survey):
    b = source.values(x, 0).field
    T = T_world_survey.inv()
    return Survey(transform_points(x, T), rotate_vectors(b, T))


@pytest.fixture(scope="session")
def make_map():
    """Map of a room, surveyed at random places (or given ones) in a frame of choice."""

    def make(seed, T_world_survey=None, x=None, sample_seed=None, source=None):
        T_world_survey = RigidTransform.identity() if T_world_survey is None else T_world_survey
        source = source or dipole_room(seed)
        if x is None:
            x = np.random.default_rng(seed if sample_seed is None else sample_seed).uniform(0, BOX, (600, 3))
        return true_map(source, survey_in(source, x, T_world_survey), T_world_survey)

    return make


@pytest.fixture(scope="session")
def make_room():
    return dipole_room
