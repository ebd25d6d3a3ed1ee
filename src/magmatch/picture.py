# SPDX-License-Identifier: BSD-3-Clause
"""A small picture for notebooks: points as inline SVG of a few kilobytes, without any plotting library."""

from collections.abc import Sequence
from html import escape

import numpy as np

WIDTH, HEIGHT, PAD = 240, 150, 8
MAX_POINTS = 400
# Dark to light, as in the figures (Viridis).
SCALE = ("#440154", "#443983", "#31688e", "#21918c", "#35b779", "#90d743", "#fde725")
BASE, TARGET, PAPER = "#00365F", "#D55E00", "#f2f4f6"


def coloured_points(p: np.ndarray, values: np.ndarray, words: str) -> str:
    """Points (n, 3) along their shortest side, coloured by values; ``words`` stand in where that cannot be seen."""
    rows = np.linspace(0, len(p) - 1, min(len(p), MAX_POINTS)).astype(int)
    p, values = p[rows], values[rows]
    low, high = np.quantile(values, [0.02, 0.98]) if len(values) else (0.0, 1.0)
    step = np.clip((values - low) / max(high - low, 1e-300) * len(SCALE), 0, len(SCALE) - 1).astype(int)
    return points_picture([(p[step == k], colour) for k, colour in enumerate(SCALE)], words)


def points_picture(groups: Sequence[tuple[np.ndarray, str]], words: str) -> str:
    """Groups of points (k, 3), each in its colour, seen along their shortest side."""
    every = np.concatenate([p for p, _ in groups])
    if not len(every):
        return ""
    size = np.ptp(every, axis=0)
    across = np.sort(np.argsort(-size, kind="stable")[:2])
    low, side = every.min(axis=0)[across], size[across]
    scale = min((WIDTH - 2 * PAD) / max(side[0], 1e-9), (HEIGHT - 2 * PAD) / max(side[1], 1e-9))
    margin = (np.array([WIDTH, HEIGHT]) - scale * side) / 2
    paths = []
    for p, colour in groups:
        x, y = (margin + scale * (p[:, across] - low)).T
        dots = "".join(f"M{a:.1f} {HEIGHT - b:.1f}h0" for a, b in zip(x, y, strict=True))
        paths.append(f'<path d="{dots}" stroke="{colour}"/>' if dots else "")
    return _svg(f'<g stroke-width="4" stroke-linecap="round" fill="none">{"".join(paths)}</g>', HEIGHT, words)


def share_picture(share: float, words: str) -> str:
    """A bar that is filled by a share from 0 to 1."""
    bar = f'<rect width="{WIDTH * min(max(share, 0.0), 1.0):.1f}" height="16" fill="{BASE}"/>'
    return _svg(bar, 16, words)


def with_picture(text: str, picture: str) -> str:
    """HTML of a text and its picture."""
    return f'<div>{picture}<pre style="margin:0">{escape(text)}</pre></div>'


def _svg(inner: str, height: int, words: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}" '
        f'role="img" aria-label="{escape(words)}" style="background:{PAPER}">{inner}</svg>'
    )
