# SPDX-License-Identifier: BSD-3-Clause
"""Maps that know the truth: of a few dipoles around a box, with analytic derivatives up to the second."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from dipoles import dipoles
from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.field.values import FieldValues
from magmatch.geometry import rotate_vectors, transform_points

EARTH = np.array([18e-6, 3e-6, -45e-6])
I3 = np.eye(3)
NUMBERS = Hyperparameters(0.6, 15e-6, 0.3e-6, 0.2)


@dataclass(frozen=True, eq=False)
class Dipoles:
    """B_a = m_b d_ab (1/r), so every derivative is one of 1/r; the Earth's field beside."""

    positions: np.ndarray
    moments: np.ndarray  # T m^3

    def values(self, x, order):
        n = len(x)
        gradient = np.zeros((n, 3, 3)) if order > 0 else None
        second = np.zeros((n, 3, 3, 3)) if order > 1 else None
        for p, m in zip(self.positions, self.moments, strict=True) if order else ():
            r = x - p
            d = np.linalg.norm(r, axis=1)
            u, mr = r @ m, m[:, None] * r[:, None, :]
            linear = mr + np.swapaxes(mr, 1, 2) + u[:, None, None] * I3
            rr = r[:, :, None] * r[:, None, :]
            gradient += 3 * linear / (d**5)[:, None, None] - (15 * u / d**7)[:, None, None] * rr
            if order > 1:
                second += second_derivative(r, m, d)
        field = EARTH + dipoles(x, self.positions, self.moments)
        return FieldValues(field, gradient, second)


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
class ExactPosterior:
    """A posterior that says what the sources say: weights are a constant field added to it."""

    source: Dipoles
    T_world_model: RigidTransform
    low: np.ndarray
    high: np.ndarray
    hyperparameters: Hyperparameters
    rim = 0.2  # m by which it knows more than its samples' box

    def evaluate(self, points, order=0, weights=None):
        values = self.source.values(transform_points(points, self.T_world_model), order)
        values = values.rotated(self.T_world_model.inv())
        return values if weights is None else FieldValues(values.field + weights, values.gradient, values.second)

    def covariance(self, points, order=0):
        size = 3 if order == 0 else 12
        return np.tile(1e-14 * np.eye(size), (len(points), 1, 1))

    def influence(self, points):
        # Of the constant field, in units of the noise.
        return np.kron(np.ones((len(points), len(points))), 1e-14 / self.hyperparameters.noise_sd**2 * I3)

    def draw_weights(self, n_draws, rng):
        return 1e-7 * rng.standard_normal((n_draws, 3))

    def knows(self, points):
        return np.all((points > self.low - self.rim) & (points < self.high + self.rim), axis=1)


def room_of_dipoles(seed, box, n=40):
    """Dipoles around, not inside, a box."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, np.add(box, 1), size=(40 * n, 3))
    p = p[np.linalg.norm(p - np.clip(p, 0, box), axis=1) > 0.35][:n]
    return Dipoles(p, 3e-6 * rng.normal(size=(n, 3)))


def survey_in(source, x, T_world_survey, noise=0.0):
    """A survey at places of the world of known sources."""
    T = T_world_survey.inv()
    return Survey(transform_points(x, T), rotate_vectors(source.values(x, 0).field + noise, T))


def exact_map(source, survey, T_world_survey, kind=ExactPosterior):
    """A map of a survey that was taken in a world of known sources."""
    T_survey_model = survey.principal_frame()
    model = survey.transformed(T_survey_model.inv()).positions
    posterior = kind(source, T_world_survey * T_survey_model, model.min(axis=0), model.max(axis=0), NUMBERS)
    return FieldMap(survey, posterior, T_survey_model, FieldConfig(prior="spline"), T_survey_model)
