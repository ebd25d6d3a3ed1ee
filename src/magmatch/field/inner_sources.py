# SPDX-License-Identifier: BSD-3-Clause
"""Equivalent sources among or next to the samples: in the holes they leave and where magnets stand, if evidence asks.

Small groups of charges are taken one after the other, each for what it adds to the evidence, so that holes of chance
stay empty and no magnet is made up.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from magmatch.field.held_out import has_path_order
from magmatch.field.holes import hole_charges
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.magnets import magnet_charges
from magmatch.field.shell import SourceShell
from magmatch.typing import Indices, Mask, Matrix, Points, Scalars, Vectors

log = logging.getLogger(__name__)

# A group must add so many nats; those that add this share of what the best does are taken with it. Along a path so
# many samples may share an error, and count as one.
_LEAST_GAIN, _TOGETHER, _SAMPLES_AS_ONE = 10.0, 0.5, 16.0
_MOST_ROUNDS = 12


def with_inner_sources(
    shell: SourceShell, points: Points, field: Vectors, h: Hyperparameters, constant_sd: float
) -> SourceShell:
    """Layer of charges with more of them where the data show sources nearer than the layer.

    Parameters
    ----------
    shell : SourceShell
    points : (n, 3) array, m
    field : (n, 3) array, T
    h : Hyperparameters
        Signal and noise of the layer.
    constant_sd : float, T
        Prior standard deviation of the constant field.

    Returns
    -------
    SourceShell
        The same where there is no need.
    """
    magnets, magnet, strength = magnet_charges(points, field, shell.distance)
    holes, hole = hole_charges(shell, points)
    charges = np.concatenate([magnets, holes])
    if len(charges) == 0:
        return shell
    group = np.concatenate([magnet, hole + magnet.max(initial=-1) + 1])
    unit = h.looseness * h.signal_sd
    scale = np.concatenate([strength / unit, np.full(len(holes), shell.scale[0])])
    design = shell.everywhere(points) * (unit / h.noise_sd)
    constant = np.kron(constant_sd / h.noise_sd * np.eye(3), np.ones((len(points), 1)))
    extra = replace(shell, sources=charges, scale=scale).everywhere(points) * (unit / h.noise_sd)
    least = _LEAST_GAIN * (_SAMPLES_AS_ONE if has_path_order(points) else 1.0)
    taken = _taken(np.hstack([design, constant]), extra, (field / h.noise_sd).T.ravel(), group, least)
    if not taken.any():
        return shell
    log.info("%d of %d charges at magnets and in holes among the samples taken", taken.sum(), len(taken))
    return shell.with_charges(charges[taken], scale[taken], points)


def _taken(design: Matrix, extra: Matrix, y: Scalars, group: Indices, least: float) -> Mask:
    """Which further columns add to the evidence, group by group: greedily, against all that was taken before."""
    base = design.T @ design
    S, u = _left(base, design.T @ extra, design.T @ y, extra.T @ extra, extra.T @ y)
    taken = np.zeros(len(group), dtype=np.bool_)
    for _ in range(_MOST_ROUNDS):
        gains = _gains(*_left(S[np.ix_(taken, taken)], S[taken], u[taken], S, u), group)
        gains[np.unique(group[taken])] = -np.inf
        best = float(gains.max())
        if best < least:
            break
        taken |= (gains >= max(least, _TOGETHER * best))[group]
    return taken


def _left(inner: Matrix, cross: Matrix, r: Scalars, outer: Matrix, q: Scalars) -> tuple[Matrix, Scalars]:
    """What data say about outer columns once inner ones, of weights with prior N(0, I), have taken their part."""
    if len(inner) == 0:
        return outer, q
    L = cholesky(inner + np.eye(len(inner)), lower=True, overwrite_a=True, check_finite=False)
    half = solve_triangular(L, np.column_stack([cross, r]), lower=True, check_finite=False)
    return outer - half[:, :-1].T @ half[:, :-1], q - half[:, :-1].T @ half[:, -1]


def _gains(S: Matrix, u: Scalars, group: Indices) -> Scalars:
    """What each group of columns adds to the log evidence: ``u^T (I + S)^-1 u / 2 - log det(I + S) / 2``."""
    gains = np.empty(group.max() + 1)
    for k in range(len(gains)):
        own = np.flatnonzero(group == k)
        L = cholesky(S[np.ix_(own, own)] + np.eye(len(own)), lower=True)
        z = solve_triangular(L, u[own], lower=True)
        gains[k] = 0.5 * z @ z - np.log(np.diag(L)).sum()
    return gains
