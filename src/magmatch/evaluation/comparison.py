# SPDX-License-Identifier: BSD-3-Clause
"""Where this package's method is not ahead, in words: nobody has to look for it in the tables."""

from collections.abc import Mapping

from magmatch.evaluation.statistics import Summary

OURS = "default"
# Methods that are told roughly where the answer is compete with nobody.
PRIVILEGED = ("gicp", "refine-rough")


def shortfalls(found: Mapping[tuple[str, str], Summary], notes: Mapping[str, str]) -> list[str]:
    """List experiments in which another method did better.

    Parameters
    ----------
    found : dict of (experiment, method) to Summary
    notes : dict of str to str
        Why, by experiment, where it is known.

    Returns
    -------
    list of str
        One line each: more right answers, fewer wrong ones, or as many right and a smaller median or 95 % error.
    """
    lines = []
    for (experiment, method), other in found.items():
        ours = found.get((experiment, OURS))
        if ours is None or method == OURS or method in PRIVILEGED:
            continue
        better = _better(other, ours)
        if better:
            why = f" {notes[experiment]}" if experiment in notes else ""
            lines.append(f"{experiment}: {method} {' and '.join(better)}.{why}")
    return lines


def _better(other: Summary, ours: Summary) -> list[str]:
    """In what another method was better."""
    if other.n_right > ours.n_right:
        return [f"was right in {other.n_right} of {other.n}, {OURS} in {ours.n_right} of {ours.n}"]
    better = []
    if other.n_false < ours.n_false:
        better.append(f"accepted wrongly {other.n_false} times, {OURS} {ours.n_false} times")
    if other.n_right == ours.n_right > 0:
        mine, theirs = ours.distance, other.distance
        if theirs.median < mine.median:
            better.append(f"had a median error of {1e3 * theirs.median:.1f} mm, {OURS} {1e3 * mine.median:.1f} mm")
        if other.angle_deg.median < ours.angle_deg.median:
            better.append(
                f"had a median error of {other.angle_deg.median:.2f} deg, {OURS} {ours.angle_deg.median:.2f} deg"
            )
    return better
