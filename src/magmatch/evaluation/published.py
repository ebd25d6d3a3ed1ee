# SPDX-License-Identifier: BSD-3-Clause
"""The published figures, as printed: their data are not public, so ours stand beside them as equivalents."""

from dataclasses import dataclass

SOURCE = "McDonald et al., Mag-Match, IROS 2025, arXiv:2508.15300, table of results"


@dataclass(frozen=True, slots=True)
class Figure:
    """Root mean square error and standard deviation: m, deg."""

    distance: float
    distance_sd: float
    angle_deg: float
    angle_sd_deg: float


# By experiment (name of our equivalent) and method. The second is printed as z but is about x.
PUBLISHED: dict[tuple[str, str], Figure] = {
    ("office-z30", "paper"): Figure(0.0816, 0.0299, 3.2316, 1.8319),
    ("office-z30", "sift"): Figure(0.0198, 0.0920, 2.0361, 0.8580),
    ("office-x30", "paper"): Figure(0.0194, 0.0036, 0.9237, 0.4023),
    ("office-x30", "sift"): Figure(0.1416, 0.0646, 10.3866, 7.6761),
    ("table-map", "paper"): Figure(0.0391, 0.0147, 3.8719, 1.0645),
    ("table-map", "sift"): Figure(0.1396, 0.0773, 9.6106, 1.577),
    ("corridor", "paper"): Figure(0.1784, 0.0836, 0.2688, 0.1076),
    ("corridor", "sift"): Figure(0.2967, 0.3253, 0.2313, 0.2764),
}
