# SPDX-License-Identifier: BSD-3-Clause
"""All pictures share this: the optional plotting library, colours, axes, origins, and how many points are drawn."""

from html import escape
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

from magmatch.data.checks import MAX_EXTENT
from magmatch.data.units import TESLA_PER_UNIT
from magmatch.errors import import_extra
from magmatch.geometry import near_origin
from magmatch.number_text import told
from magmatch.typing import Indices, Points, Scalars, Vector3, Vectors

# Plotly's figure: Plotly has no types, and is imported when something is drawn.
Figure: TypeAlias = Any

# Told apart by every kind of colour vision and on a grey printout: lightness differs by a contrast of three, to each
# other and to the paper. Marker shapes differ as well.
BASE_COLOR, TARGET_COLOR, LINK_COLOR = "#00365F", "#D55E00", "#57606A"
BASE_MARKER, TARGET_MARKER = "circle", "diamond"
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
# Lightness rises all along these scales.
FIELD_SCALE, SPREAD_SCALE = "Viridis", "Cividis"
INK, QUIET = "#1b1f24", "#d4d9df"
PAPER, GROUND, SHADE, FILL = "white", "#f2f4f6", "#C9D6E2", "#9FB3C6"
# What a page of the dark theme draws instead: lightness turned round, hue kept.
DARK = {
    BASE_COLOR: "#7CB8EA", TARGET_COLOR: "#FFA15C", LINK_COLOR: "#A9B4C0", INK: "#e6e9ed", QUIET: "#3d4651",
    PAPER: "#14181d", GROUND: "#20262d", SHADE: "#2C4157", FILL: "#56718C",
}  # fmt: skip
# Half of what a scene shows at unit distance (45 deg from top to bottom), less the room for labels.
SCENE_HEIGHT, SCENE_WIDTH = 0.36, 0.38
# Most samples drawn of one survey: what a phone turns smoothly, and what keeps a page small.
MAX_DRAWN = 5000
# m: origins taken off coordinates are whole multiples, so that pictures of one place have one.
STEP = 1e3
UT_PER_TESLA = 1 / TESLA_PER_UNIT["uT"]


def require_plotly() -> ModuleType:
    """Plotly's graph objects; a missing Plotly is an error that names the extra."""
    return import_extra("plotly.graph_objects", "a picture", "viz")


def thinned(n: int, n_drawn: int = MAX_DRAWN) -> Indices:
    """Choose evenly which of n samples are drawn: row numbers, all of them where they are few."""
    return np.linspace(0, n - 1, min(n, n_drawn), dtype=np.int64)


def magnitude_ut(field: Vectors) -> Scalars:
    """Field magnitudes in uT, for display."""
    return np.asarray(UT_PER_TESLA * np.linalg.norm(field, axis=1))


def label(text: str) -> str:
    """Make a name safe where plotly would take it for markup."""
    return escape(text, quote=False)


def origin_of(*points: Points) -> Vector3:
    """Give the whole kilometres taken off coordinates before they are drawn: zero unless they lie far off."""
    everything = np.concatenate(points)
    return near_origin(everything[np.isfinite(everything).all(axis=1)], STEP)


def origins_of(*frames: Points) -> list[Vector3]:
    """Give what is taken off the coordinates of each frame before they are overlaid.

    It is one point for all, unless they lie farther apart than any survey extends: a picture of one frame in UTM and
    one with an origin of its own would show two dots.
    """
    origin = origin_of(*frames)
    if max(float(np.abs(p - origin).max()) for p in frames) <= MAX_EXTENT:
        return [origin] * len(frames)
    return [origin_of(p) for p in frames]


def axis_title(axis: int, origin: Vector3, unit: str = "m") -> str:
    """Name of a coordinate, and what was taken off it."""
    off = float(origin[axis])
    taken_off = "" if off == 0 else f" {'-' if off > 0 else '+'} {told(abs(off))}"
    return f"{'xyz'[axis]}{taken_off} ({unit})"


def for_display(values: np.ndarray) -> np.ndarray:
    """Single precision is plenty for a screen and halves the page: of coordinates without their origin."""
    return np.asarray(values, dtype=np.float32)


def points3d(p: Points, **style: Any) -> Any:
    """Markers in space; `new_scene` takes their origin off."""
    x, y, z = p.T
    return require_plotly().Scatter3d(x=x, y=y, z=z, mode="markers", **style)


def marks3d(
    p: Points, name: str | None, color: str, symbol: str, size: float, *, opacity: float = 1.0, **style: Any
) -> Any:
    """Markers in space, all of one look."""
    marker = {"size": size, "color": color, "symbol": symbol, "opacity": opacity}
    return points3d(p, name=name, marker=marker, **style)


def between(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Points of one line per row, as a single trace: rows are parted by gaps."""
    return np.stack([starts, ends, np.full_like(starts, np.nan)], axis=1).reshape(-1, starts.shape[1])


def curves3d(p: Points, **style: Any) -> Any:
    """Curves in space, as a single trace: parted where a row is NaN; `new_scene` takes their origin off."""
    x, y, z = p.T
    return require_plotly().Scatter3d(x=x, y=y, z=z, mode="lines", hoverinfo="skip", **style)


def flat(p: np.ndarray, mode: str = "markers", **style: Any) -> Any:
    """Markers or lines at (n, 2) places of a flat figure."""
    x, y = for_display(p).T
    return require_plotly().Scatter(x=x, y=y, mode=mode, **style)


def described(figure: Figure, words: str) -> Figure:
    """Give a figure the words that stand for it where it cannot be seen; those below take them as `alt`."""
    figure.layout.meta = {**(figure.layout.meta or {}), "alt": words}
    return figure


# Plotly makes room for what stands here, whatever the height.
AT_THE_FOOT = {"yref": "container", "y": 0.0, "yanchor": "bottom"}


def colorbar(unit: str) -> dict[str, Any]:
    """Scale of colours below a picture: beside it, it would take a phone's width."""
    place = {"orientation": "h", "thickness": 12, "len": 0.9, "outlinewidth": 0, **AT_THE_FOOT}
    return place | {"ticksuffix": f" {unit}" if unit else ""}


def coloured_by_field(magnitude: Scalars, limits: tuple[float, float]) -> dict[str, Any]:
    """Colours of markers by field magnitude, uT."""
    colors = {"color": for_display(magnitude), "colorscale": FIELD_SCALE, "cmin": limits[0], "cmax": limits[1]}
    return colors | {"colorbar": colorbar("uT")}


def new_scene(title: str, traces: list[Any], frame: str, alt: str, *, unit: str = "m") -> Figure:
    """Put traces into a 3-D figure with equal scales, about an origin near them that its axes name."""
    points = [np.column_stack([t.x, t.y, t.z]) for t in traces]
    origin = origin_of(*points)
    points = [for_display(p - origin) for p in points]
    for trace, p in zip(traces, points, strict=True):
        trace.update(dict(zip("xyz", p.T, strict=True)))
    figure = require_plotly().Figure(traces)
    figure.update_layout(
        **_layout(f"{title}<br><sub>{label(frame)}</sub>"),
        scene=_box(np.concatenate(points), origin, unit),
        height=480,
        legend={"orientation": "h", "x": 0, "itemsizing": "constant", **AT_THE_FOOT},
    )
    return described(figure, alt)


def _box(p: Points, origin: Vector3, unit: str) -> dict[str, Any]:
    """Axes around points, sized by their longest side.

    Plotly's own aspect mode 'data' scales by volume, which blows flat surveys up beyond the picture.
    """
    low, high = np.nanmin(p, axis=0).astype(np.float64), np.nanmax(p, axis=0).astype(np.float64)
    longest = max(float((high - low).max()), 1e-9)
    pad = np.maximum(0.05 * longest, (0.2 * longest - (high - low)) / 2)
    low, high = low - pad, high + pad
    aspect = 1.6 * (high - low) / (high - low).max()
    axes = {
        f"{axis}axis": {
            "title": {"text": axis_title(k, origin, unit)},
            "range": [float(low[k]), float(high[k])],
            # Numbers along a short side would lie upon each other.
            "nticks": 2 + int(6 * (high - low)[k] / (high - low).max()),
            "backgroundcolor": PAPER,
            "gridcolor": QUIET,
            "zerolinecolor": QUIET,
            "showspikes": False,
        }
        for k, axis in enumerate("xyz")
    }
    aspect_ratio = dict(zip("xyz", aspect.tolist(), strict=True))
    return {"aspectmode": "manual", "aspectratio": aspect_ratio, "camera": _camera(aspect), **axes}


def _camera(aspect: np.ndarray) -> dict[str, Any]:
    """Look at a box from so far that its corners just fill the picture, with room for the labels."""
    back = np.array([0.53, -0.69, 0.49])
    across = np.cross([0, 0, 1.0], back) / np.linalg.norm(np.cross([0, 0, 1.0], back))
    up = np.cross(back, across)
    corners = 0.5 * aspect * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    needed = np.maximum(np.abs(corners @ across) / SCENE_WIDTH, np.abs(corners @ up) / SCENE_HEIGHT) + corners @ back
    eye = float(needed.max()) * back
    return {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "center": {"x": 0, "y": 0, "z": -0.1}}


def new_plane(
    title: str, traces: list[Any], x_title: str, y_title: str, alt: str = "", *, is_equal: bool = True
) -> Figure:
    """Put traces into a flat figure."""
    figure = require_plotly().Figure(traces)
    figure.update_layout(**_layout(title), height=400, legend={"orientation": "h", "x": 0, **AT_THE_FOOT})
    figure.update_xaxes(title_text=x_title, gridcolor=QUIET, zeroline=False, constrain="domain", automargin=True)
    figure.update_yaxes(title_text=y_title, gridcolor=QUIET, zeroline=False, automargin=True)
    if is_equal:
        # Stated, so that pictures of one cut have one size; a page makes a picture as high as its content asks for.
        x, y = (_range([np.ravel(trace[axis]) for trace in traces]) for axis in "xy")
        figure.update_xaxes(range=x)
        figure.update_yaxes(range=y, scaleanchor="x", scaleratio=1, constrain="domain")
        figure.layout.meta = {"shape": (y[1] - y[0]) / (x[1] - x[0])}
    return described(figure, alt) if alt else figure


def _range(parts: list[np.ndarray]) -> list[float]:
    """Range of an axis: from the least value to the largest, with a little around it."""
    values = np.concatenate([np.zeros(0), *parts])
    low, high = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else (0.0, 1.0)
    pad = max(0.02 * (high - low), 1e-3)
    return [float(low - pad), float(high + pad)]


def _layout(title: str) -> dict[str, Any]:
    return {
        "title": {"text": title, "x": 0.01, "xanchor": "left", "y": 0.97, "yanchor": "top", "font": {"size": 15}},
        "template": "none",
        "margin": {"l": 8, "r": 8, "t": 62, "b": 8},
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": INK},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": GROUND,
    }
