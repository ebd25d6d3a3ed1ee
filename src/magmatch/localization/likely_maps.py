# SPDX-License-Identifier: BSD-3-Clause
"""The maps that a body may be in: one, or those of a folder that its path votes for."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future

import numpy as np

from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.localization.belief import BIN_LENGTH, Belief
from magmatch.localization.bins import STEP
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import KnownPlaces
from magmatch.registration.index.atlas import Atlas, AtlasEntry
from magmatch.registration.search.retrieval import count_votes, shortlist
from magmatch.typing import Scalars

log = logging.getLogger(__name__)
# Path between two votes of a folder's maps, in field lengths.
VOTE_EVERY = 2.0


class LikelyMaps:
    """The belief in each likely map."""

    def __init__(self, known: KnownPlaces, config: LocalizerConfig) -> None:
        self.config, self.known = config, known
        self._bins = np.zeros(0, STEP)
        self._n_until_vote = round(config.min_window / BIN_LENGTH)
        self.likely: dict[AtlasEntry | None, Belief] = {}
        self._voting: Future[Scalars] | None = None
        self._awaited: list[AtlasEntry] = []
        self.why_none = "the body has moved too little"
        if known.is_constant:
            self.why_none = "the map's field is constant: nothing tells places apart"
        elif known.atlas is None:
            self.likely = {None: Belief(known.of(None), config)}

    @property
    def best(self) -> Belief | None:
        """The belief in the likeliest map; None before any was voted for."""
        return max(self.likely.values(), key=lambda belief: (belief.is_sure, belief.log_odds), default=None)

    @property
    def is_outside(self) -> bool:
        """Whether a body whose place is trusted is outside of what its map knows."""
        return (best := self.best) is not None and best.is_sure and not best.is_inside

    @property
    def is_settled(self) -> bool:
        """Whether a place is trusted, and stands."""
        return (best := self.best) is not None and best.is_sure and best.stands

    def take(self, done: np.ndarray, may_search: Callable[[], bool] = lambda: True) -> None:
        """Take a bin along the path, (1,) of STEP: follow it in each likely map, doubt, search, judge."""
        for belief in self.likely.values():
            belief.follow(done)
        if self.known.atlas is not None:
            self._bins = np.concatenate([self._bins, done])[-round(self.config.window / BIN_LENGTH) :]
            if self._is_sure:
                # It is in one map: of the others those remain that its path supports, and none is searched.
                self._keep_likely()
            else:
                self._vote(self.known.atlas)
                self._begin()
        for belief in self.likely.values():
            if belief.is_doubtful():
                belief.doubt()
        due = [] if self._is_sure else [belief for belief in self.likely.values() if belief.is_due()]
        # That which waits longest first.
        for belief in sorted(due, key=lambda one: one.searched_at):
            if may_search():
                belief.search()
        odds = {key: belief.weigh() for key, belief in self.likely.items()}
        for key, belief in self.likely.items():
            others = [o for other, o in odds.items() if other is not key]
            belief.judge(float(np.logaddexp.reduce(others, initial=-np.inf)))

    @property
    def _is_sure(self) -> bool:
        return any(belief.is_sure for belief in self.likely.values())

    def _keep_likely(self, voted: Sequence[AtlasEntry] = ()) -> None:
        self.likely = {key: b for key, b in self.likely.items() if key in voted or b.log_odds > 0}

    def probabilities(self) -> dict[str, float]:
        """Give the probability of each likely map, most likely first; what is left is that the body is in none."""
        ranked = sorted(self.likely.values(), key=lambda belief: -belief.total_odds)
        terms = np.array([*(belief.total_odds for belief in ranked), -np.log(self.config.decision.prior_odds)])
        shares = np.exp(terms - np.logaddexp.reduce(terms)).tolist()
        return {belief.name: share for belief, share in zip(ranked, shares, strict=False)}

    def _vote(self, atlas: Atlas) -> None:
        """Vote for maps from time to time; beliefs in maps that are no longer likely are dropped."""
        self._n_until_vote -= 1
        if self._n_until_vote <= 0 and self._voting is None:
            self._n_until_vote = round(VOTE_EVERY / BIN_LENGTH)
            p, b = self._bins["p"], np.stack([one["R"] @ one["z"] for one in self._bins])
            tables = [entry.table for entry in atlas.entries]
            self._voting = self.known.aside(count_votes, tables, Survey(p, b), 0)
        if self._voting is None or not self._voting.done():
            return
        votes, self._voting = self._voting.result(), None
        voted = [atlas.entries[k] for k in shortlist(votes)]
        self._keep_likely(voted)
        self._awaited = [entry for entry in voted if entry not in self.likely]

    def _begin(self) -> None:
        """Start beliefs in the maps that were voted for, as soon as each is ready."""
        for entry in list(self._awaited):
            try:
                known = self.known.soon(entry)
            except DataFormatError as error:
                if self.known.loader is None:
                    raise
                # Its file has changed since: the others can still be searched.
                log.info("not searched: %s", error)
                self._awaited.remove(entry)
                continue
            if known is not None:
                self.likely[entry] = Belief(known, self.config)
                for k in range(len(self._bins)):
                    self.likely[entry].follow(self._bins[k : k + 1])
        self._awaited = [entry for entry in self._awaited if entry not in self.likely]
