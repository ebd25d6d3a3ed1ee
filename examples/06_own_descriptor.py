# SPDX-License-Identifier: BSD-3-Clause
"""A descriptor of one's own in the published method, beside the published one, in a simulated room.

Run: python examples/06_own_descriptor.py [FIGURE.html]
"""

import sys

import numpy as np
import plotly.graph_objects as go

import magmatch as mm
from magmatch import published
from magmatch.published import Inferred, LocalFrames
from magmatch.simulation import SimulationConfig


def sorted_magnitudes(inferred: Inferred, frames: LocalFrames) -> np.ndarray:
    """Quantiles of |B| over each keypoint's support, uT: no motion of the map changes them.

    ``frames.support`` holds rows of X*, -1 where a support is cut; ``frames.axes`` the local frames, not needed here.
    """
    magnitude = 1e6 * np.linalg.norm(inferred.field, axis=1)
    around = np.where(frames.support >= 0, magnitude[frames.support], np.nan)
    return np.nanquantile(around, np.linspace(0, 1, 16), axis=1).T


def main(path: str = "own_descriptor.html") -> None:
    pair = mm.simulate("office-random", seed=1, config=SimulationConfig(n_samples=1000))
    # Mapped once, with the published prior, for both descriptors.
    base, target = (mm.build_map(survey, published.FIELD) for survey in (pair.base, pair.target))

    figure = go.Figure()
    for name, descriptor in (("published (HOV)", None), ("sorted magnitudes", sorted_magnitudes)):
        found = published.register(base, target, descriptor=descriptor)
        rows = found.matches.base_rows, found.matches.target_rows
        there = pair.T_base_target.apply(found.target.positions[rows[1]])
        apart = np.linalg.norm(found.base.positions[rows[0]] - there, axis=1)
        spacing = found.config.features.spacing
        print(f"{name}: {found}")
        print(f"  {np.mean(apart < 2 * spacing):.0%} of the matches are within two spacings of the truth")
        if found.candidates:
            error = found.candidates[0].T_base_target * pair.T_base_target.inv()
            off = np.linalg.norm(error.apply(pair.base.centroid) - pair.base.centroid)
            print(f"  best pose off by {1e3 * off:.0f} mm and {np.degrees(error.rotation.magnitude()):.2f} deg")
        figure.add_scatter(x=np.sort(apart), y=np.linspace(0, 1, len(apart)), name=name)

    figure.update_layout(
        title="Matches by their error under the true transform",
        xaxis_title="error (m)",
        yaxis_title="share of matches",
    )
    figure.write_html(path)
    print(f"figure: {path}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
