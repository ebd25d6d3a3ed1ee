# SPDX-License-Identifier: BSD-3-Clause
"""The maps that are most likely to hold a target, searched in full, and the best answer of all."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from magmatch.atlas.atlas import Atlas, AtlasEntry
from magmatch.progress import tell
from magmatch.registration.clock import Clock
from magmatch.registration.result import RegistrationResult
from magmatch.registration.steps import settle_and_decide
from magmatch.registration.strategy import Strategy, Weighed


def best_of(
    atlas: Atlas, likely: list[AtlasEntry], strategy: Strategy[Any, Any, Any], clock: Clock
) -> RegistrationResult:
    """Weigh poses in each map and decide on the best of all, with the search penalty for the whole atlas."""
    weighed = {}
    for k, entry in enumerate(likely):
        tell(f"searching {entry.name}", k / len(likely))
        with clock("load"):
            base = atlas.load(entry)
        with clock("prepare"):
            pair = strategy.pair(base, atlas.volume)
        with clock("search"):
            found = strategy.search(pair)
        with clock("refine"):
            weighed[entry] = strategy.refine_and_weigh(pair, found)
    answers = {}
    for entry, elsewhere in _best_elsewhere(weighed).items():
        best = replace(weighed[entry], elsewhere=elsewhere)
        answers[entry] = settle_and_decide(best, atlas.config.decision, clock)
    return _with_alternatives(answers)


def _best_elsewhere(weighed: Mapping[AtlasEntry, Weighed[Any, Any, Any]]) -> dict[AtlasEntry, float]:
    """Log odds of the best pose in any other map; the map of the best pose first."""
    odds = {entry: one.best_log_odds for entry, one in weighed.items()}
    ranked = sorted(odds, key=lambda entry: -odds[entry])
    return {entry: max((odds[other] for other in ranked if other is not entry), default=-np.inf) for entry in ranked}


def _with_alternatives(judged: dict[AtlasEntry, RegistrationResult]) -> RegistrationResult:
    """State the answer of the best map and, for a refusal, the best pose of each other map; best first."""
    (best, answer), *others = judged.items()
    if answer.is_accepted:
        return replace(answer, base=best.name)
    elsewhere = tuple(replace(r.alternatives[0], base=entry.name) for entry, r in others if r.alternatives)
    return replace(
        answer, base=best.name if answer.alternatives else None, alternatives=answer.alternatives + elsewhere
    )
