# SPDX-License-Identifier: BSD-3-Clause
"""One pose under several models of the walk, equally likely beforehand, as one: the mixture's moments."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from magmatch.geometry import perturbation, perturbation_between
from magmatch.registration.weigh.refine_and_weigh_walk import LineEvidence


def in_order(found: Iterable[LineEvidence | None]) -> list[LineEvidence]:
    """Those that exist, with most evidence first."""
    return sorted((one for one in found if one is not None), key=lambda one: -one.log_evidence)


def mixture(models: Sequence[LineEvidence]) -> LineEvidence:
    """Average the evidence of models of one pose; its covariance holds how far their poses are apart."""
    best, evidence = in_order(models)[0], np.array([one.log_evidence for one in models])
    total = float(np.logaddexp.reduce(evidence))
    if not np.isfinite(total):
        return best
    shares, c = np.exp(evidence - total), best.center
    off = np.stack([perturbation_between(best.T_base_target, one.T_base_target, c) for one in models])
    mean, within = shares @ off, np.tensordot(shares, [one.covariance for one in models], axes=1)
    return replace(
        best,
        T_base_target=best.T_base_target * perturbation(mean, c),
        covariance=within + (off - mean).T @ (shares[:, None] * (off - mean)),
        log_evidence=total - float(np.log(len(models))),
        attainable=max(one.attainable for one in models),
    )
