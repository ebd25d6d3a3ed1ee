# SPDX-License-Identifier: BSD-3-Clause
"""The part of a survey whose evidence is computed: large enough to be representative, small enough to be fast."""

import numpy as np

from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.selection.spline_evidence import EvidenceSearch
from magmatch.field.subset import choose_part
from magmatch.typing import Points, Vectors

# Operations of one factorisation of the part that is searched: a constant and a share per sample. Of a path it has to
# hold many lanes that cross: from few, nothing tells what they miss of one another.
PART_OPERATIONS, PART_OF_A_PATH = (6e8, 1.5e5), (2e9, 1e4)
# Of a short path, as many as this, and less than a share of any tells too little: so many may be spent on that.
SHORT_PATH, LEAST_OPERATIONS, SHARE_OF_A_PATH, SHARE_OPERATIONS = 20_000, 3e9, 0.3, 8e9
# Where samples lie anywhere, the share of those operations that a smaller part takes.
SMALLER_PART = 0.35
FEWEST_OF_A_PART, MOST_SEARCHED, MOST_CUTS = 300, 50_000, 4


def search_part(points: Points, field: Vectors, start: Hyperparameters, is_path: bool) -> EvidenceSearch:
    """Search over a part of the survey."""
    n = len(points)
    if not is_path:
        return _search(points, field, start, PART_OPERATIONS[0] + PART_OPERATIONS[1] * n, 0, MOST_SEARCHED)
    budget = max(PART_OF_A_PATH[0] + PART_OF_A_PATH[1] * n, LEAST_OPERATIONS if n <= SHORT_PATH else 0.0)
    return _search(points, field, start, budget, int(SHARE_OF_A_PATH * n), MOST_SEARCHED)


def search_smaller_part(
    points: Points, field: Vectors, start: Hyperparameters, search: EvidenceSearch
) -> EvidenceSearch:
    """Search that tells all but the spacing and the last of the noise, of samples that lie anywhere."""
    return _search(points, field, start, SMALLER_PART * search.operations(start), 0, len(search.points))


def _search(
    points: Points, field: Vectors, start: Hyperparameters, budget: float, least: int, most: int
) -> EvidenceSearch:
    """Search over a part that costs a budget; a larger one where ``least`` samples can be paid for."""
    n = min(len(points), most)
    part = np.ones(len(points), dtype=bool) if n == len(points) else choose_part(points, n, 3)
    for cut in range(MOST_CUTS + 1):
        search = EvidenceSearch(points[part], field[part], np.flatnonzero(part), np.float32)
        needed = search.operations(start)
        is_enough = n <= FEWEST_OF_A_PART or (n <= least and needed <= SHARE_OPERATIONS)
        if needed <= budget or is_enough or cut == MOST_CUTS:
            break
        fewest = max(FEWEST_OF_A_PART, least if n > least else 0)
        n = max(int(n * max((budget / needed) ** 0.7, 0.1) * 0.95), fewest)
        part = choose_part(points, n, 1 if 3 * n > len(points) else 3)
    return search
