# SPDX-License-Identifier: BSD-3-Clause
"""The belief about a body in one map: hypotheses, the latest bins as their evidence, and which one is trusted."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.estimation.posterior import Answer, Posterior, log_odds, posterior_of
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import (
    LocalizerStatus,
    PoseEstimate,
    PoseHypothesis,
    if_accurate,
    too_uncertain,
    uncertain_words,
)
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import FIT, LatestBins, follow
from magmatch.localization.null_model import UnrelatedFields
from magmatch.localization.start.search import search
from magmatch.localization.state import BIAS, hypotheses, model_of
from magmatch.localization.weigh_hypotheses import (
    OutsidePenalty,
    WeighedHypothesis,
    covariance_of,
    end_of_agreement,
    evidence,
    forget,
    is_doubtful,
    stated,
    weigh,
)
from magmatch.preparation.odometry.drift import FACTOR_ODDS, FACTORS
from magmatch.registration.decide.decision import in_words, too_low
from magmatch.typing import Matrix

# Length of a bin in field lengths: short against the field's changes, long against noise.
BIN_LENGTH = 0.25
# Bins by which a contradiction may have begun later than the evidence has it.
BREAK = 2
# Log odds under the likeliest at which a hypothesis is forgotten, nats.
NO_CHANCE = -14.0
NOTHING: Posterior[WeighedHypothesis] = Posterior((), (), 0.0, 1.0)


def untested_words(found: str, tested: float) -> str:
    """Say why a place that was found is not stated yet: it has not been known for the path (m) that tests it."""
    return f"{found}; it is stated once it has stood {tested:.3g} m"


class Belief:
    """The belief, updated bin by bin."""

    def __init__(self, known: KnownMap, config: LocalizerConfig) -> None:
        # Whether its first hypothesis is trusted: probable enough, and known well enough; and log odds (nats) over
        # the null model that the body is not in the map, of the most likely hypothesis and of all together.
        self.is_sure, self.log_odds, self.total_odds = False, -np.inf, -np.inf
        self._known, self._config, self._model = known, config, model_of(known, config)
        self._most, self._recent = round(config.window / BIN_LENGTH), round(config.recent / BIN_LENGTH)
        self.unrelated = UnrelatedFields(known, self._model, config)
        self._window, self._bank = LatestBins.of(len(self.unrelated.now)), hypotheses(0)
        self._weighed: list[WeighedHypothesis] = []
        self._found = NOTHING
        self._words = self._why()
        # States of the trusted hypothesis before each of the latest bins, and the first bin whose evidence counts;
        # and the path at the last search, m.
        self._trail: list[np.ndarray] = []
        self._since, self._was_sure, self.searched_at = 0, False, -np.inf
        # Path in the map since the place became known as it is now; NaN where it is not.
        self._stood = np.nan

    @property
    def name(self) -> str:
        """Name of the map."""
        return self._known.name

    def follow(self, new: np.ndarray) -> None:
        """Update all hypotheses with one bin, (1,) of STEP."""
        if len(self._window) == self._most:
            # Older evidence is capped at the prior odds that the track was not lost since.
            if self._since == 0:
                forget(self._window, self._known, self._penalty, self._bank)
            self._window, self._since = self._window[1:], max(self._since - 1, 0)
        self._window.add(new)
        if self.is_sure:
            self._trail = [*self._trail, self._bank[:1].copy()][-self._recent :]
        last = self._window[-1:]
        follow(self._bank, self._known, self._model, last.steps, last.fit, moves_first=True)
        self.unrelated.follow(last.steps, last.null)

    @property
    def _penalty(self) -> OutsidePenalty:
        """A place that stands may leave the map; others come into it as seldom as a track is lost."""
        n_free = len(self._weighed[0].rows) if self.is_sure and self.stands else 0
        # At most the prior log odds that the track was not lost since.
        most = -float(np.log(self._config.end_probability))
        return OutsidePenalty(self._config.price_outside / self._known.length, n_free, most)

    def is_doubtful(self) -> bool:
        """Whether the trusted hypothesis is contradicted by the latest bins."""
        odds = 1 / self._config.end_probability - 1
        return self.is_sure and is_doubtful(self._window[-self._recent :], self._known, odds)

    @property
    def _counting(self) -> LatestBins:
        """The bins whose evidence counts."""
        return self._window[self._since :]

    def doubt(self) -> None:
        """Trust no hypothesis; from now on, evidence counts only from where the contradiction began."""
        window, recent = self._window, len(self._trail)
        # Nothing was forgotten of a body outside the map.
        self._bank["earlier"] = np.minimum(self._bank["earlier"], self._penalty.most)
        last = max(len(window) - recent, 0)
        self._since = min(last + end_of_agreement(window[last:]) + BREAK, len(window) - 1)
        window.null = self.unrelated.begin_anew(window.steps[self._since :], window.null)
        self._join(*self._with_another_bias(recent))
        self.is_sure, self.searched_at, self._trail, self._stood = False, -np.inf, [], np.nan

    def _with_another_bias(self, recent: int) -> tuple[np.ndarray, np.ndarray]:
        """The trusted hypothesis with a jump of the sensor's bias at the most likely of the latest bins."""
        window = self._window
        bank, fit = hypotheses(0), np.zeros((len(window), 0), FIT)
        for back in range(recent, 1, -1):
            one, fared = self._trail[-back].copy(), window.fit[:, :1].copy()
            one["P"][0, BIAS : BIAS + 3, BIAS : BIAS + 3] += self._config.bias_sd**2 * np.eye(3)
            one["earlier"] = np.log(self._config.end_probability / recent)
            follow(one, self._known, self._model, window.steps[-back:], fared[-back:], moves_first=True)
            bank, fit = np.concatenate([bank, one]), np.concatenate([fit, fared], axis=1)
        gained, *_ = evidence(replace(window, fit=fit)[self._since :], self._known, self._penalty)
        best = np.argsort(-gained, kind="stable")[:1]
        return bank[best], np.ascontiguousarray(fit[:, best])

    def _join(self, bank: np.ndarray, fit: np.ndarray) -> None:
        self._bank = np.concatenate([self._bank, bank])
        self._window.join(fit)

    def _keep(self, rows: Sequence[int]) -> None:
        self._bank = self._bank[rows]
        self._window.keep(rows)

    def is_due(self) -> bool:
        """Whether it is time to look for other hypotheses."""
        if self.is_sure:
            return False
        walked, length = self._counting.steps["walked"], self._known.length
        is_long = walked[-1] - walked[0] >= self._config.min_window * length
        return bool(is_long and walked[-1] - self.searched_at >= self._config.min_window / 2 * length)

    def search(self) -> None:
        """Search for hypotheses without a prior, using the bins that count."""
        steps = self._counting.steps
        self.searched_at = steps[-1]["walked"]
        self._join(*search(self._known, self._model, steps, self._config))

    def weigh(self) -> float:
        """Weigh all hypotheses and keep distinct ones, most likely first; returns the log odds of all, nats."""
        same = self._config.same(self._known.length)
        weighed = weigh(self._bank, self._counting, self._known, self._penalty, same)
        odds = [log_odds(w.log_evidence, w.misfit, w.kind) for w in weighed]
        ranked = sorted(zip(odds, weighed, strict=True), key=lambda one: -one[0])
        self.log_odds = ranked[0][0] if ranked else -np.inf
        self.total_odds = float(np.logaddexp.reduce(odds, initial=-np.inf))
        # Improbable hypotheses are dropped: a search would find them again.
        self._weighed = [w for odds, w in ranked if odds > self.log_odds + NO_CHANCE][: self._config.n_hypotheses]
        rows = [row for w in self._weighed for row in w.rows]
        if not rows or 0 not in self._weighed[0].rows:
            self.is_sure, self._trail, self._stood = False, [], np.nan
        if rows != list(range(len(self._bank))):
            self._keep(rows)
        return self.total_odds

    def judge(self, elsewhere: float) -> None:
        """Trust the most likely hypothesis if it is probable enough, given those of other maps (log odds)."""
        decision = self._config.decision
        self._found = posterior_of([Answer.of([w]) for w in self._weighed], decision.prior_odds, elsewhere)
        self._words = f"probability {in_words(self._found.best)}"
        is_known, off = self._is_place_known(), ""
        if is_known:
            best = self._found.poses[0]
            off = too_uncertain(covariance_of(best.one, self._known, best.factor), self._most_sd)
        self.is_sure = is_known and not off
        if not is_known or np.isnan(self._stood):
            self._stood = 0.0 if is_known else np.nan
        elif self.is_inside:
            self._stood += math.hypot(*self._window.steps[-1]["u"])
        if self.is_sure:
            self._was_sure |= self.stands
            self._follow_other_drifts()
            return
        self._trail = []
        self._words = uncertain_words(self._words, off) if off else self._why()

    def _follow_other_drifts(self) -> None:
        """Follow the trusted pose also under other drifts of the odometry, of which evidence tells in time."""
        if len(self._weighed[0].rows) > 1:
            return
        n = len(FACTORS)
        self._keep([*[0] * n, *range(1, len(self._bank))])
        self._bank["earlier"][:n] += FACTOR_ODDS
        self._bank["drift"][:n] = FACTORS**2
        self._weighed[0] = replace(self._weighed[0], rows=tuple(range(n)))

    @property
    def stands(self) -> bool:
        """Whether the place has been known for long enough to be stated: a first fix is the best of many starts.

        Path outside the map puts it to no test.
        """
        return self._stood >= self._path_to_stand

    @property
    def is_inside(self) -> bool:
        """Whether the map knows the most likely place at the last bin."""
        return bool(self._window.fit[-1, 0]["is_known"])

    def _is_place_known(self) -> bool:
        return bool(self._found.poses) and self._found.best >= self._config.decision.min_probability

    @property
    def _most_sd(self) -> tuple[float, float]:
        return self._config.decision.max_sd(self._known.length)

    def estimate(self, T: Matrix, *, at_once: bool) -> PoseEstimate:
        """The present estimate, at a pose in the odometry's frame, (4, 4); see `Localizer.estimate`."""
        stands = self._is_place_known() and (at_once or self.stands)
        if not (self.is_sure and stands):
            status = LocalizerStatus.LOST if self._was_sure else LocalizerStatus.SEARCHING
            words = untested_words(self._words, self._path_to_stand) if self.is_sure else self._words
            return PoseEstimate(status, words, probability=self._found.best, is_place_known=stands)
        factor, last = self._found.poses[0].factor, self._window.steps[-1:]
        likely = self._bank[: len(self._weighed[0].rows)]
        # Outside the map nothing tells how odometry drifts: that it does so less than stated was learned inside.
        row = 0 if self.is_inside else int(np.argmax(likely["drift"] >= 1))
        said = stated(likely[row : row + 1].copy(), last, T, self._known, self._model, factor)[0]
        found = PoseEstimate(
            LocalizerStatus.LOCALIZED if self.is_inside else LocalizerStatus.DEAD_RECKONING,
            self._words if self.is_inside else f"{self._words}, outside what the map knows",
            said["T"], said["covariance"], self._found.best, said["bias"], said["bias_sd"], float(said["scale"]),
            self._known.name, float(said["gain"]), float(said["drift"]), is_place_known=True,
        )  # fmt: skip
        # It is less certain than at the last bin by the way since, and outside by other odds of the drift.
        return found if at_once else if_accurate(found, self._most_sd)

    @property
    def _path_to_stand(self) -> float:
        return self._config.stands * self._known.length

    def hypotheses(self) -> list[PoseHypothesis]:
        """Hypotheses at the last bin, most likely first."""
        T_map_model = RigidTransform.from_matrix(self._known.T_map_model)
        found = zip(self._found.poses, self._found.probabilities, strict=True)
        return [PoseHypothesis(self._known.name, T_map_model * w.T_base_target, odds) for w, odds in found]

    def _why(self) -> str:
        """Why the place is not known."""
        found = self._found
        if not found.poses:
            return "the body has moved too little, or nothing in the map resembles its path"
        needed = self._config.decision.min_probability
        said = f"the best pose has probability {too_low(found.best)}, {needed:g} is needed"
        if found.rivals > found.null:
            return f"{said}; others have {found.rivals:.2g} together"
        reasons = ["the body is not in the map", "the field along its path has too little structure so far"]
        reasons += ["z is not up in both (--no-gravity)"] if self._config.is_gravity_aligned else []
        return f"{said}: {', '.join(reasons[:-1])}, or {reasons[-1]}"
