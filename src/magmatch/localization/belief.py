# SPDX-License-Identifier: BSD-3-Clause
"""What is believed of a body in one map: hypotheses, the last bins that weighed them, and which is trusted."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.localization.bins import Bin
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import Estimate, LocalizerStatus
from magmatch.localization.known_map import KnownMap
from magmatch.localization.measurement import Fit, Steps, follow
from magmatch.localization.monitor import (
    Crowd,
    Weighed,
    covariance_of,
    end_of_agreement,
    evidence,
    gains,
    is_doubtful,
    weigh,
)
from magmatch.localization.null_model import NullModel
from magmatch.localization.start import search
from magmatch.localization.state import BIAS, Bank, model_of, predict
from magmatch.registration.decide.decision import in_words
from magmatch.registration.decide.estimate import worst_sd
from magmatch.registration.decide.posterior import Posterior, log_odds, posterior_of
from magmatch.registration.prepared.walk import BIN_LENGTH
from magmatch.typing import Matrix

# Bins by which a contradiction may have begun later than the evidence has it.
BREAK = 2
# Log odds under the likeliest at which a hypothesis is forgotten, nats.
NO_CHANCE = -14.0
NOTHING: Posterior[Weighed] = Posterior((), (), 0.0, 1.0)


class Belief:
    """Grows by one bin at a time.

    Attributes
    ----------
    is_sure : bool
        Whether its first hypothesis is trusted: probable enough, and known well enough.
    log_odds : float, nats
        Of the likeliest hypothesis over a place that is not the map.
    """

    def __init__(self, known: KnownMap, config: LocalizerConfig) -> None:
        self.is_sure, self.log_odds = False, -np.inf
        self._known, self._config, self._model = known, config, model_of(known, config)
        self._most, self._recent = round(config.window / BIN_LENGTH), round(config.recent / BIN_LENGTH)
        self._steps, self._crowd, self._null_fit = Steps.none(), Crowd.none(), Fit.empty(0, 0)
        self._null = NullModel(known, self._model, config)
        self._weighed: list[Weighed] = []
        self._found = NOTHING
        # States of the trusted hypothesis before each of the latest bins, and the first bin whose evidence counts.
        self._trail: list[Bank] = []
        self._since, self._was_sure, self._searched_at = 0, False, -np.inf

    def follow(self, new: Bin) -> None:
        """Take all hypotheses on by one bin."""
        if len(self._steps) == self._most:
            self._forget_first()
        self._steps = self._steps.then(new, self._most)
        last = self._steps.rows(slice(-1, None))
        if self.is_sure:
            self._trail = [*self._trail, self._crowd.bank.rows(np.array([0]))][-self._recent :]
        self._crowd = self._crowd.after(follow(self._crowd.bank, self._known, self._model, last, moves_first=True))
        self._null_fit = (
            self._null_fit.then(self._null.follow(last)) if len(self._steps) > 1 else self._null.follow(last)
        )

    def _forget_first(self) -> None:
        """What is older counts up to the odds that nothing has ended since; of a body outside the map, all of it."""
        outside = self._price()[:, 0] * (self._crowd.is_seen & ~self._crowd.fit.is_known)[:, 0]
        gained = gains(self._crowd, self._null_fit, slice(1))[:, 0] - outside
        most = np.full(len(gained), -np.log(self._config.end_probability))
        if self.is_sure and not self._crowd.fit.is_known[0, -1]:
            most[0] = np.inf
        self._crowd = self._crowd.without_first(gained, most)
        self._null_fit = self._null_fit.columns(slice(1, None))
        self._since = max(self._since - 1, 0)

    def _price(self) -> np.ndarray:
        """What bins outside the map cost: nothing a hypothesis that is trusted, which may leave the map."""
        step = np.sqrt((self._steps.u**2).sum(axis=1)) * self._config.price_outside / self._known.length
        price = np.tile(step, (len(self._crowd), 1))
        if self.is_sure:
            price[0] = 0.0
        return price

    def is_doubtful(self) -> bool:
        """Whether the trusted hypothesis is contradicted by the latest bins."""
        odds = 1 / self._config.end_probability - 1
        return self.is_sure and is_doubtful(self._crowd, self._null_fit, self._known, self._recent, odds)

    def doubt(self) -> None:
        """Trust none; only evidence from where the contradiction began counts from now on."""
        recent = len(self._trail)
        self._since = min(end_of_agreement(self._crowd, self._null_fit, recent) + BREAK, len(self._steps) - 1)
        self._null_fit = self._null.begin_anew(self._steps.rows(slice(self._since, None)), self._null_fit)
        self._crowd = self._crowd.joined(self._with_another_bias(recent))
        self.is_sure, self._searched_at, self._trail = False, -np.inf, []

    def _with_another_bias(self, recent: int) -> Crowd:
        """The trusted hypothesis, had the sensor's bias jumped at one of the latest bins: the likeliest of them."""
        one, tried = self._crowd.rows(np.array([0])), Crowd.none(len(self._steps))
        for back in range(recent, 1, -1):
            bank = self._trail[-back].rows(np.array([0]))
            bank.P[0, BIAS : BIAS + 3, BIAS : BIAS + 3] += self._config.bias_sd**2 * np.eye(3)
            fit = follow(bank, self._known, self._model, self._steps.rows(slice(-back, None)), moves_first=True)
            paid = np.array([np.log(self._config.end_probability / recent)])
            tried = tried.joined(Crowd(bank, one.fit.columns(slice(-back)).then(fit), one.is_seen, paid))
        if not len(tried):
            return tried
        gained, *_ = evidence(tried, self._null_fit, self._known, np.zeros_like(tried.fit.chi2), self._since)
        return tried.rows(np.array([int(np.argmax(gained))]))

    def is_due(self) -> bool:
        """Whether it is time to look for other hypotheses."""
        walked, length = self._steps.walked, self._known.length
        is_long = walked[-1] - walked[self._since] >= self._config.min_window * length
        return bool(
            not self.is_sure and is_long and walked[-1] - self._searched_at >= self._config.search_every * length
        )

    def search(self) -> None:
        """Look for hypotheses from nowhere, by the bins that count."""
        self._searched_at = self._steps.walked[-1]
        found = search(self._known, self._model, self._steps.rows(slice(self._since, None)), self._config)
        n, k = len(self._steps), len(found.bank.s)
        seen = np.ones((k, n), dtype=np.bool_)
        seen[:, : self._since] = False
        fit = Fit.empty(k, self._since).then(found.fit)
        self._crowd = self._crowd.joined(Crowd(found.bank, fit, seen, np.full(k, found.log_prior)))

    def weigh(self) -> float:
        """Weigh all hypotheses and keep distinct ones, likeliest first; log odds of the first, nats."""
        config, decision = self._config, self._config.decision
        same = decision.tolerance(self._known.length)
        weighed = weigh(self._crowd, self._null_fit, self._known, self._price(), self._since, same)
        ranked = sorted(((log_odds(w.log_evidence, w.misfit, w.kind), w) for w in weighed), key=lambda one: -one[0])
        self.log_odds = ranked[0][0] if ranked else -np.inf
        # What has no chance is forgotten: it would be found again.
        self._weighed = [w for odds, w in ranked if odds > self.log_odds + NO_CHANCE][: config.n_hypotheses]
        self._crowd = self._crowd.rows(np.array([w.row for w in self._weighed], dtype=np.int64))
        if not self._weighed or self._weighed[0].row != 0:
            self.is_sure, self._trail = False, []
        return self.log_odds

    def judge(self, elsewhere: float) -> None:
        """Trust the likeliest where it is probable enough, other maps' hypotheses (log odds) considered too."""
        decision = self._config.decision
        self._found = posterior_of(self._weighed, decision.prior_odds, elsewhere)
        self.is_sure = self._found.best >= decision.min_probability and self._is_known_well(self._found.poses[0])
        self._was_sure |= self.is_sure
        if not self.is_sure:
            self._trail = []

    def _is_known_well(self, one: Weighed) -> bool:
        most = self._config.decision.max_sd(self._known.length)
        return all(sd <= limit for sd, limit in zip(worst_sd(one.covariance), most, strict=True))

    def estimate(self, T: Matrix) -> Estimate:
        """What is known now, at a pose in the odometry's frame, (4, 4)."""
        if not self.is_sure:
            status = LocalizerStatus.LOST if self._was_sure else LocalizerStatus.SEARCHING
            return Estimate(status, self._why(), probability=self._found.best)
        bank = self._crowd.bank.rows(np.array([0]))
        R0, p0 = self._steps.R[-1], self._steps.p[-1]
        dR, u = np.ascontiguousarray(R0.T @ T[:3, :3]), R0.T @ (T[:3, 3] - p0)
        predict(0, bank.R, bank.p, bank.c, bank.s, bank.P, dR, u, 0.0, self._known.up, self._model)
        T_model_body = np.eye(4)
        T_model_body[:3, :3], T_model_body[:3, 3] = bank.R[0], bank.p[0]
        is_in = bool(self._crowd.fit.is_known[0, -1])
        return Estimate(
            LocalizerStatus.LOCALIZED if is_in else LocalizerStatus.DEAD_RECKONING,
            f"probability {in_words(self._found.best)}{'' if is_in else ', outside what the map knows'}",
            RigidTransform.from_matrix(self._known.T_map_model @ T_model_body),
            covariance_of(bank, 0, self._known, self._found.poses[0].factor),
            self._found.best, bank.b[0], np.sqrt(np.diag(bank.P[0])[BIAS : BIAS + 3]), 1 + float(bank.s[0]),
            self._known.name,
        )  # fmt: skip

    def _why(self) -> str:
        found = self._found
        if not found.poses:
            return "too little was walked, or nothing in the map resembles it"
        if found.best >= self._config.decision.min_probability:
            return "the place is found, but not to the accuracy asked for"
        if found.rivals > found.null:
            return f"the best pose has probability {found.best:.2g}, others {found.rivals:.2g} together"
        return (
            f"the best pose has probability {found.best:.2g}: another place than the map's, or too little was walked"
        )
