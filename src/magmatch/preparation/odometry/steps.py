# SPDX-License-Identifier: BSD-3-Clause
"""Steps of a walk from the vertical acceleration, and how long each is."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

from magmatch.typing import Indices, Scalars

# Steps: peaks of the vertical acceleration below this frequency (Hz), so far apart (s), so high above the valleys
# beside them (m/s^2). People walk at 1.4 to 2.5 steps a second.
STEP_FREQUENCY, STEP_INTERVAL, STEP_PROMINENCE = 3.0, 0.35, 1.0
# Peaks further apart than this (s) are a stop, not a step.
LONGEST_STEP = 1.2
# Weinberg (2002), Analog Devices AN-602: a step is K (a_max - a_min)^(1/4) long; K in m^(3/4) s^(1/2), chosen on
# routes 1 to 3 of IPIN's training logs of 2023.
WEINBERG_FACTOR = 0.469


@dataclass(frozen=True, eq=False, slots=True)
class Steps:
    """Steps between consecutive peaks of the vertical acceleration."""

    first: Indices  # (n,): rows between which each step was made
    last: Indices  # (n,)
    lengths: Scalars  # (n,), m: by Weinberg's rule

    def __len__(self) -> int:
        return len(self.lengths)

    def within(self, pieces: Indices) -> "Steps":
        """Those that begin and end in one piece; `pieces` numbers the rows."""
        is_whole = pieces[self.first] == pieces[self.last]
        return Steps(self.first[is_whole], self.last[is_whole], self.lengths[is_whole])

    def speed(self, n: int, rate: float) -> Scalars:
        """Speed of the walk at each of n rows, m/s: even within a step, 0 where none is made."""
        change = np.zeros(n + 1)
        speeds = self.lengths * rate / (self.last - self.first)
        np.add.at(change, self.first, speeds)
        np.add.at(change, self.last, -speeds)
        speed: Scalars = np.maximum(np.cumsum(change)[:n], 0)
        return speed


def find_steps(vertical: Scalars, rate: float, scale: float = 1.0) -> Steps:
    """Steps in the vertical acceleration (m/s^2, gravity taken off or not), ``rate`` times a second.

    Length ``scale K (a_max - a_min)^(1/4)`` of the low-passed acceleration within the step (Weinberg 2002).
    """
    filter_ = butter(2, STEP_FREQUENCY, fs=rate, output="sos")
    smooth = sosfiltfilt(filter_, vertical - np.median(vertical)) if len(vertical) > 20 else np.zeros(len(vertical))
    apart = max(1, round(STEP_INTERVAL * rate))
    peaks, _ = find_peaks(smooth, distance=apart, prominence=STEP_PROMINENCE)
    first, last = peaks[:-1], peaks[1:]
    is_step = last - first <= LONGEST_STEP * rate
    first, last = first[is_step], last[is_step]
    swings = np.array([np.ptp(smooth[i:j]) for i, j in zip(first, last, strict=True)])
    return Steps(first, last, scale * WEINBERG_FACTOR * swings**0.25)
