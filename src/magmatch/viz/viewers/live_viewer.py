# SPDX-License-Identifier: BSD-3-Clause
"""A live 3-D viewer in the browser (viser): surveys, movable cuts through maps, and a movable target."""

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.errors import import_extra
from magmatch.viz.figures.plotting import magnitude_ut
from magmatch.viz.figures.slices import cut_normal_to, cut_through
from magmatch.viz.viewers.exhibit import Exhibit, Part, box_of, cut_colors, shaded

QUANTITIES = ("field magnitude", "standard deviation")
BY_FIELD, BY_SURVEY = "field magnitude", "survey"
# A sample's size against the scene's.
POINT_SHARE = 0.003


def require_viser() -> ModuleType:
    """The viewer's library."""
    return import_extra("viser", "the live viewer", "view")


@contextmanager
def serve(shown: Exhibit, port: int) -> Iterator[Any]:
    """Show an exhibit at a web address while the block runs, to this machine only.

    If `port` is in use, the next free one is taken; `address_of` gives the address.
    """
    viser = require_viser()
    with redirect_stdout(io.StringIO()):  # it prints a table of addresses, and a word when it stops
        server = viser.ViserServer(host="127.0.0.1", port=port, label="magmatch", verbose=False)
    try:
        _furnish(server, shown)
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def address_of(server: Any) -> str:
    """Where the viewer is."""
    return f"http://{server.get_host()}:{server.get_port()}"


def _furnish(server: Any, shown: Exhibit) -> None:
    """Put everything into the scene, with its controls."""
    # The button would send the scene to a server elsewhere.
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.scene.set_up_direction("+z")
    low, high = box_of(shown)
    size = max(float(np.linalg.norm(high - low)), 1e-3)
    center = (low + high) / 2
    server.initial_camera.look_at = tuple(center)
    server.initial_camera.position = tuple(center + size * np.array([0.42, -0.72, 0.6]))
    server.gui.add_markdown("  \n".join(shown.words))
    length = 0.04 * size
    frames = {
        part.name: server.scene.add_frame(f"/{part.name}", axes_length=length, axes_radius=0.03 * length)
        for part in shown.parts
    }
    if shown.result is not None:
        _add_links(server, shown, frames["target"], size)
    _add_samples(server, shown, POINT_SHARE * size)
    for part in shown.parts:
        _add_cut(server, shown, part)


def _add_samples(server: Any, shown: Exhibit, point_size: float) -> None:
    """Samples of all parts, with a choice of what colours them and how large they are."""
    first = BY_FIELD if shown.result is None else BY_SURVEY
    clouds = [
        server.scene.add_point_cloud(
            f"/{part.name}/samples",
            points=part.survey.positions[part.rows].astype(np.float32),
            colors=_colors(shown, part, first),
            point_size=point_size,
            point_shape=part.shape,
            precision="float32",
            point_shading="flat",
        )
        for part in shown.parts
    ]
    choice = server.gui.add_dropdown("Colour of samples", (BY_FIELD, BY_SURVEY), initial_value=first)
    size = server.gui.add_slider("Size of samples", min=0.2, max=4.0, step=0.1, initial_value=1.0)

    @choice.on_update
    def _(_: Any) -> None:
        for cloud, part in zip(clouds, shown.parts, strict=True):
            cloud.colors = _colors(shown, part, choice.value)

    @size.on_update
    def _(_: Any) -> None:
        for cloud in clouds:
            cloud.point_size = size.value * point_size


def _add_links(server: Any, shown: Exhibit, target: Any, size: float) -> None:
    """A slider that moves the target, and lines between corresponding keypoints, which follow it."""
    lines, links = None, shown.links(1.0)
    if len(links):
        lines = server.scene.add_line_segments("/links", points=links, colors=(87, 96, 106), thickness=0.001 * size)
    if shown.T_base_target is None:
        return
    is_accepted = shown.result is not None and shown.result.is_accepted
    name = "Registered" if is_accepted else "Best candidate (not accepted)"
    slider = server.gui.add_slider(name, min=0.0, max=1.0, step=0.02, initial_value=1.0)

    def move(share: float) -> None:
        T = shown.pose_of_target(share)
        target.wxyz = T.rotation.as_quat(scalar_first=True)
        target.position = T.translation
        if lines is not None:
            lines.points = shown.links(share)

    move(1.0)

    @slider.on_update
    def _(_: Any) -> None:
        move(slider.value)


def _add_cut(server: Any, shown: Exhibit, part: Part) -> None:
    """A cut through a part's map, if it has one, that can be moved along an axis."""
    field_map, p = part.field_map, part.survey.positions
    if field_map is None:
        return
    first = cut_through(p)
    low, high = p.min(axis=0), p.max(axis=0)
    with server.gui.add_folder(f"Map of {part.name}"):
        # Of two maps registered on one another, one at a time can be seen.
        is_seen = server.gui.add_checkbox("Show", initial_value=shown.result is None or part.name == "base")
        quantity = server.gui.add_dropdown("Colour", QUANTITIES)
        axis = server.gui.add_dropdown("Cut across", tuple("xyz"), initial_value="xyz"[first.axes[2]])
        share = server.gui.add_slider("Place along it", min=0.0, max=1.0, step=0.02, initial_value=0.5)
        k = first.axes[2]
        share.value = float(np.clip((first.height - low[k]) / max(high[k] - low[k], 1e-9), 0, 1))

    def draw(_: Any = None) -> None:
        normal = "xyz".index(axis.value)
        height = float(low[normal] + share.value * (high[normal] - low[normal]))
        cut = cut_normal_to(p, normal, height)
        colors, is_known = cut_colors(field_map, cut, quantity.value, shown.limits)
        image = np.concatenate([colors, 255.0 * is_known[:, None]], axis=1).astype(np.uint8)
        a, b, _ = cut.axes
        axes = np.stack([np.eye(3)[a], np.eye(3)[b], np.cross(np.eye(3)[a], np.eye(3)[b])], axis=1)
        server.scene.add_image(
            f"/{part.name}/cut",
            image.reshape(len(cut.second), len(cut.first), 4),
            render_width=float(np.ptp(cut.first)),
            render_height=float(np.ptp(cut.second)),
            wxyz=Rotation.from_matrix(axes).as_quat(scalar_first=True),
            position=cut.points.mean(axis=0),
            visible=is_seen.value,
        )

    draw()
    for control in (is_seen, quantity, axis, share):
        control.on_update(draw)


def _colors(shown: Exhibit, part: Part, choice: str) -> np.ndarray:
    if choice == BY_SURVEY:
        return np.tile(part.color.astype(np.uint8), (len(part.rows), 1))
    return shaded(magnitude_ut(part.survey.field[part.rows]), shown.limits).astype(np.uint8)
