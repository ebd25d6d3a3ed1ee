# SPDX-License-Identifier: BSD-3-Clause
"""Cells, elimination, factor and selected inverse against dense linear algebra."""

import tracemalloc

import numpy as np
import pytest

from magmatch.errors import ConfigurationError
from magmatch.field.cholesky.cells import lay_cells
from magmatch.field.cholesky.multifrontal import factorise
from magmatch.field.cholesky.nested_dissection import order_elimination
from magmatch.field.cholesky.selected_inverse import selected_inverse
from magmatch.field.cholesky.stencil_matrix import StencilMatrix
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.spline.spline_model import SplineModel
from magmatch.field.spline.spline_prior import CONSTANT_SD, outside_covariance, smoothness_matrix
from magmatch.threads import on_one_core
from oracles.dense_matrix import to_dense

SHAPES = {"volume": (1.0, 0.7, 0.4), "plane": (1.2, 1.0, 0.0), "line": (2.5, 0.0, 0.0), "point": (0.0, 0.0, 0.0)}


def system(shape, seed=0, leaf_size=60, n=150):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 1, (n, 3)) * shape
    h = Hyperparameters(0.4, 1e-5, 1e-6, 0.15, 100.0)
    cells = lay_cells(x, h.spacing, 1.5)
    model = SplineModel(h, order_elimination(cells, leaf_size))
    information = model.observe(x, 1e-5 * rng.normal(size=(n, 3)))
    return model, information.gram + model.prior_precision(), information


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_factor_solves_like_dense_cholesky(shape):
    model, A, information = system(shape)
    dense = to_dense(A, model.cells)
    factor = factorise(model.elimination, A)
    solution = factor.solve(information.eta)
    scale = np.linalg.norm(dense, 2) * np.linalg.norm(solution)
    assert np.linalg.norm(dense @ solution - information.eta) < 1e-12 * scale
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-12)


def test_memory_of_what_a_front_leaves_is_free_once_its_parent_has_used_it():
    model, A, _ = system((3.0, 2.5, 0.0))
    left = 8 * sum(len(front.border) ** 2 for front in model.elimination.fronts)
    tracemalloc.start()
    # On one core: of two threads, each may hold what a child left at the same time, as their turns happen to fall.
    factor = on_one_core(factorise, model.elimination, A)
    most = tracemalloc.get_traced_memory()[1] - factor.n_bytes
    tracemalloc.stop()
    assert most < 0.5 * left


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_selected_inverse_equals_the_dense_inverse_in_every_cell(shape):
    model, A, _ = system(shape)
    inverse = np.linalg.inv(to_dense(A, model.cells))
    selected = to_dense(selected_inverse(factorise(model.elimination, A)), model.cells)
    m = model.cells.n_nodes
    for nodes in model.cells.cell_nodes:
        rows = np.ix_(np.r_[nodes, m : m + 3], np.r_[nodes, m : m + 3])
        np.testing.assert_allclose(selected[rows], inverse[rows], atol=1e-9 * np.abs(inverse).max())


def test_indefinite_matrix_is_refused_with_the_pivot():
    model, A, _ = system((0.5, 0.5, 0.0))
    broken = StencilMatrix(A.stencil.copy(), A.border, A.corner)
    broken.stencil[7, 0] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match="pivot"):
        factorise(model.elimination, broken)


@pytest.mark.parametrize("k", [0, 1, 2, 3])
def test_smoothness_is_the_integral_of_squared_derivatives_of_monomials(k):
    """Node values of ``x^k / k!`` sampled by B-splines reproduce it, and |grad^k x^k / k!|^2 = 1."""
    i = np.arange(-1.0, 3.0)
    along = {0: np.ones(4), 1: i, 2: i**2 - 1 / 3, 3: i**3 - i}[k] / [1, 1, 2, 6][k]
    w = np.einsum("a,b,c->abc", along, np.ones(4), np.ones(4)).ravel()
    assert w @ smoothness_matrix(k) @ w == pytest.approx(1.0, rel=1e-10)


@pytest.mark.parametrize("divergence_weight", [0.0, 300.0])
def test_outside_of_all_cells_the_prior_is_the_mean_of_a_lone_cells(divergence_weight):
    """Which is that of the dense model of one cell and its reach, at points that integrate splines exactly.

    So the field varies at a lone sample as `signal_sd` says.
    """
    h = Hyperparameters(0.5, 2e-6, 1e-7, 0.2, divergence_weight, reach=1.5)
    model = SplineModel.over(np.zeros((1, 3)), h)
    prior = model.infer(model.observe(np.zeros((0, 3)), np.zeros((0, 3))))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    points = np.stack(np.meshgrid(*[h.spacing * nodes / 2] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    mean = np.average(
        prior.covariance(points, order=1), axis=0, weights=np.einsum("i,j,k->ijk", *[weights] * 3).ravel()
    )
    mean[:3, :3] -= CONSTANT_SD**2 * np.eye(3)
    np.testing.assert_allclose(mean, outside_covariance(h, np.zeros((3, 3))), rtol=1e-6, atol=1e-6 * mean[0, 0])
    np.testing.assert_allclose(mean[:3, :3], h.signal_sd**2 * np.eye(3), rtol=1e-6, atol=1e-6 * mean[0, 0])


def test_region_too_large_for_its_spacing_is_refused_in_one_line():
    x = np.array([[0.0, 0, 0], [1e4, 1e4, 1e4]])
    with pytest.raises(ConfigurationError, match="widen the spacing"):
        lay_cells(x, 0.1, 2.5)
