# SPDX-License-Identifier: BSD-3-Clause
"""Prepared maps of fields known everywhere, and weighed poses, made by hand: stages are tested on them."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.features.invariants import rotation_invariants
from magmatch.field.values import FieldValues
from magmatch.geometry import rotate_third_order, rotate_vectors, transform_points
from magmatch.registration.prepared.drift import Drift
from magmatch.registration.prepared.prepared_map import PreparedMap
from magmatch.registration.prepared.raster import Raster

# Transforms of tangent vectors (6,), rotation first (rad, m), and back.
exp_se3, log_se3 = RigidTransform.from_exp_coords, RigidTransform.as_exp_coords
EARTH = np.array([18e-6, 3e-6, -45e-6])


@dataclass(frozen=True, eq=False)
class Polynomial:
    """``B(x) = b + G x + x' Q x / 2``, T; weights are a field added to it: a polynomial, or a constant."""

    constant: np.ndarray = field(default_factory=lambda: EARTH)
    linear: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    second: np.ndarray = field(default_factory=lambda: np.zeros((3, 3, 3)))

    def plus(self, other):
        """The sum of two fields."""
        return Polynomial(self.constant + other.constant, self.linear + other.linear, self.second + other.second)

    def evaluate(self, points, order=0, weights=None):
        if weights is not None:
            added = weights if isinstance(weights, Polynomial) else Polynomial(weights)
            return self.plus(added).evaluate(points, order)
        values = (
            self.constant + points @ self.linear.T + 0.5 * np.einsum("abc,nb,nc->na", self.second, points, points)
        )
        gradient = self.linear + np.einsum("abc,nc->nab", self.second, points)
        return FieldValues(values, gradient if order else None)

    def knows(self, points):
        return np.ones(len(points), dtype=bool)

    def seen_from(self, T_here_there):
        """The same field in another frame."""
        origin = self.evaluate(T_here_there.inv().translation[None], 1).rotated(T_here_there)
        return Polynomial(origin.field[0], origin.gradient[0], rotate_third_order(self.second[None], T_here_there)[0])


@dataclass(frozen=True, eq=False)
class Drawn:
    """A field map as far as its draws need it: its posterior, whose weights are what a draw differs by."""

    posterior: Polynomial


def some_field(seed, slope=8e-6, bend=8e-6):
    """A field without sources: symmetric and traceless in all its derivatives."""
    rng = np.random.default_rng(seed)
    G = rng.normal(size=(3, 3))
    G = G + G.T - 2 * np.trace(G) / 3 * np.eye(3)
    # Of the potential x^3 / 3 - x y^2, seen from some sides.
    cubic = np.zeros((3, 3, 3))
    cubic[0, 0, 0], cubic[0, 1, 1], cubic[1, 0, 1], cubic[1, 1, 0] = 2, -2, -2, -2
    sides = Rotation.random(4, random_state=rng).as_matrix()
    Q = sum(np.einsum("ai,bj,ck,ijk->abc", R, R, R, cubic) for R in sides)
    return Polynomial(EARTH, slope * G / np.linalg.norm(G) * 3, bend * Q / np.linalg.norm(Q) * 3)


def raster_of(posterior, low, high, spacing, sd=0.0):
    """All of a box."""
    shape = tuple(int(n) for n in np.ceil((np.asarray(high) - low) / spacing) + 1)
    points = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.asarray(low) + spacing * points
    rows = np.arange(len(points))
    spread = np.full(len(points), sd) if np.ndim(sd) == 0 else sd(points)
    return Raster.knowing(np.asarray(low, float), spacing, shape, rows, posterior.evaluate(points).field, spread)


def prepared_map(posterior, samples, rng=None, *, noise_sd=0.3e-6, sd=0.0, spacing=0.1, length=0.6, drift=None):
    """A map of a box around its samples, whose measured vectors are noisy where there is an ``rng``."""
    measured = posterior.evaluate(samples).field
    if rng is not None:
        measured = measured + noise_sd * rng.standard_normal(samples.shape)
    at = posterior.evaluate(samples, 1)
    low, high = samples.min(axis=0) - 0.35, samples.max(axis=0) + 0.35
    none = Drift(0.0, 0.0, np.zeros(len(samples), dtype=np.int64), np.zeros((1, 1)))
    return PreparedMap(
        field_map=None,
        T_map_model=RigidTransform.identity(),
        posterior=posterior,
        samples=samples,
        sample_field=measured,
        points=samples,
        point_field=at.field,
        point_gradient=at.gradient,
        gradient_sd=np.full(len(samples), 1e-7),
        invariants=rotation_invariants(at.field, at.gradient),
        invariant_sd=np.full((len(samples), 6), 1e-7),
        raster=raster_of(posterior, low, high, spacing, sd),
        correlation_length=length,
        noise_sd=noise_sd,
        drift=drift or none,
        draws=list,
    )


def seen_from(prepared, T, spacing=0.1, sd=0.0):
    """The same map in another model frame, that T takes it to."""
    posterior = prepared.posterior.seen_from(T)
    again = prepared_map(
        posterior, transform_points(prepared.samples, T), noise_sd=prepared.noise_sd, sd=sd, spacing=spacing,
        length=prepared.correlation_length, drift=prepared.drift,
    )  # fmt: skip
    return replace(again, sample_field=rotate_vectors(prepared.sample_field, T))


def box(rng, n, size=(2.0, 1.6, 0.8)):
    """Samples in a box about the origin."""
    return rng.uniform(-0.5, 0.5, (n, 3)) * size


def turn_about(center, xi):
    """The motion ``Exp(xi)`` about a centre: turn by xi[:3] about it, then shift by xi[3:]."""
    R = Rotation.from_rotvec(xi[:3])
    return RigidTransform.from_components(np.asarray(center) + xi[3:] - R.apply(center), R)


@dataclass(frozen=True, eq=False)
class WeighedPose:
    """A hypothesis as a decision sees it: by default one that is beyond doubt."""

    T_base_target: RigidTransform = field(default_factory=RigidTransform.identity)
    log_evidence: float = 200.0
    misfit: float = 1.0
    kind: str = "map"
    model: str = "rigid"
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    covariance: np.ndarray | None = field(default_factory=lambda: 1e-6 * np.eye(6))
    attainable: float = 300.0
    overlap: float = 0.9
    drift: None = None
