# SPDX-License-Identifier: BSD-3-Clause
"""Steps of a walk from the vertical acceleration, and how long each is."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

from magmatch.preparation.odometry.config import DeadReckoningConfig
from magmatch.typing import Indices, Scalars


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


def find_steps(vertical: Scalars, config: DeadReckoningConfig) -> Steps:
    """Steps in the vertical acceleration (m/s^2, gravity taken off or not) at even times.

    Length ``K (a_max - a_min)^(1/4)`` of the low-passed acceleration within the step (Weinberg 2002).
    """
    filter_ = butter(2, config.step_frequency, fs=config.rate, output="sos")
    smooth = sosfiltfilt(filter_, vertical - np.median(vertical)) if len(vertical) > 20 else np.zeros(len(vertical))
    apart = max(1, round(config.step_interval * config.rate))
    peaks, _ = find_peaks(smooth, distance=apart, prominence=config.step_prominence)
    first, last = peaks[:-1], peaks[1:]
    is_step = last - first <= config.longest_step * config.rate
    first, last = first[is_step], last[is_step]
    swings = np.array([np.ptp(smooth[i:j]) for i, j in zip(first, last, strict=True)])
    return Steps(first, last, config.weinberg_factor * swings**0.25)
