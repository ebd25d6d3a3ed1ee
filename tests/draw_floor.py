# SPDX-License-Identifier: BSD-3-Clause
"""Draw the pictures of docs/floor.md: paths and points before and after slam, |B|, and the held-out walk.

Run: python tests/draw_floor.py FOLDER, in which the commands of the page have run. Matplotlib is needed, which
no extra installs.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Ellipse

import magmatch as mm
from magmatch.phones import open_walk

IMAGES = Path(__file__).parents[1] / "docs" / "images"
MICRO = 1e6
# Where |B| is less sure than half of what it varies by over the floor, its colour says little.
GREY_BEYOND = 0.5
# What the page tells localize: less certainty, and odometry as good as slam takes it.
LOOSE = mm.LocalizerConfig(odometry={"sd": (0.3, 4.0)}, decision={"min_probability": 0.6})
# Radius of a 95 % ellipse in the plane, in standard deviations.
ELLIPSE_95 = 2.45


def main(folder: Path) -> None:
    logs = [open_walk(path).survey() for path in sorted((folder / "mall" / "walks").glob("*.txt.gz"))]
    field_map = mm.FieldMap.load(folder / "floor" / "map.map")
    result = mm.SlamResult.load(folder / "floor" / "result.json")
    corrected = [mm.read_survey(folder / "floor" / f"{log.name}.csv") for log in result.logs]
    given = [log.transformed(its.T_map_log) for log, its in zip(logs, result.logs, strict=True)]

    figure, (before, after) = plt.subplots(1, 2, figsize=(5.6, 6.0), sharex=True, sharey=True, layout="constrained")
    for axes, walks, title in ((before, given, "Odometry, first poses held"), (after, corrected, "After slam")):
        axes.set_title(title, fontsize=10)
        for walk in walks:
            axes.plot(*walk.positions[:, :2].T, linewidth=1)
        places = np.array([a.position for a in result.anchors])
        label = "surveyed points" if axes is before else None
        axes.plot(*places[:, :2].T, "kx", markersize=4, label=label)
        plan(axes)
    figure.legend(loc="outside lower center", fontsize=8)
    save(figure, "floor-paths")

    figure, axes = plt.subplots(figsize=(4.0, 6.0), layout="constrained")
    image = show_field(axes, field_map)
    figure.colorbar(image, label="|B| in uT; grey: uncertain", shrink=0.6)
    save(figure, "floor-field")

    walk = open_walk(folder / "mall" / "held_out.txt.gz").survey()
    track = mm.localize(field_map, walk, LOOSE)
    figure, axes = plt.subplots(figsize=(3.4, 6.0), layout="constrained")
    show_field(axes, field_map, alpha=0.35)
    show_track(axes, track)
    figure.legend(loc="outside lower center", fontsize=8)
    save(figure, "floor-where")


def show_field(axes: Axes, field_map: mm.FieldMap, alpha: float = 1.0) -> AxesImage:
    """|B| where the map knows the field, grey where it is uncertain."""
    positions = field_map.survey.positions
    (x0, y0), (x1, y1) = positions[:, :2].min(axis=0) - 3, positions[:, :2].max(axis=0) + 3
    x, y = np.arange(x0, x1, 0.4), np.arange(y0, y1, 0.4)
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), positions[:, 2].mean())], axis=-1).reshape(-1, 3)
    values = field_map.evaluate(points)
    strength = np.linalg.norm(values.field, axis=1)
    along = values.field / strength[:, None]
    sd = np.sqrt(np.einsum("ni,nij,nj->n", along, field_map.covariance(points), along))
    known = field_map.knows(points)
    is_sure = known & (sd < GREY_BEYOND * strength[known].std())
    shape, extent = (len(y), len(x)), (x0, x1, y0, y1)
    grey = np.where(known & ~is_sure, 0.7, np.nan).reshape(shape)
    axes.imshow(grey, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, alpha=alpha)
    sure = np.where(is_sure, MICRO * strength, np.nan).reshape(shape)
    image = axes.imshow(sure, origin="lower", extent=extent, alpha=alpha)
    plan(axes)
    return image


def show_track(axes: Axes, track: mm.Track) -> None:
    """Stated poses, ellipses of some, and the walk's own points, each joined to the pose that is stated there."""
    points = track.log.waypoints
    for t, place in zip(points.times, points.places, strict=True):
        e = track.estimates[int(np.argmin(np.abs(track.log.times - t)))]
        if e.is_stated:
            axes.plot(*np.array([place, e.T_map_body.translation[:2]]).T, "k-", linewidth=1.2, zorder=3)
    axes.plot(*points.places.T, "kx", markersize=5, label="its surveyed points, not used")
    stated = [e for e in track.estimates if e.is_stated]
    places = np.array([e.T_map_body.translation[:2] for e in stated])
    axes.plot(*places.T, ".", color="tab:red", markersize=2, label="stated poses, 95 % ellipses")
    for e in stated[:: max(1, len(stated) // 12)]:
        turn = e.T_map_body.rotation.as_matrix()
        sizes, directions = np.linalg.eigh((turn @ e.covariance[3:, 3:] @ turn.T)[:2, :2])
        angle = np.degrees(np.arctan2(directions[1, 1], directions[0, 1]))
        small, large = 2 * ELLIPSE_95 * np.sqrt(sizes)
        middle = tuple(e.T_map_body.translation[:2])
        axes.add_patch(Ellipse(middle, large, small, angle=angle, fill=False, color="tab:red"))


def plan(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def save(figure: plt.Figure, name: str) -> None:
    figure.savefig(IMAGES / f"{name}.webp", dpi=110, pil_kwargs={"quality": 80})
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
