# SPDX-License-Identifier: BSD-3-Clause
"""What all 3-D viewers show: surveys and maps, each in its frame, and the pose of that frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from magmatch.data.survey import Survey
from magmatch.field.map import FieldMap
from magmatch.geometry import rotation_matrix
from magmatch.registration.maps import survey_of
from magmatch.registration.result import RegistrationResult
from magmatch.typing import Indices, Mask, Matrix, Scalars
from magmatch.viz.figures.plotting import UT_PER_TESLA, magnitude_ut, thinned
from magmatch.viz.figures.registration_figures import shown_pose
from magmatch.viz.figures.slices import Cut, common_limits, field_on
from magmatch.viz.verdict import headline

# Most samples drawn of one survey: what a viewer turns smoothly without a graphics card.
MAX_SHOWN = 100_000
MAX_LINKS = 200
SHAPES = ("circle", "diamond", "square")
# Navy through grey to yellow: lightness rises all along, and nearly everyone tells blue from yellow.
SHADES = np.array([[0, 34, 78], [60, 77, 110], [124, 123, 120], [187, 175, 110], [254, 232, 56]], dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A survey or a map, in its own frame."""

    name: str  # unique among the parts; what its node is called
    survey: Survey
    field_map: FieldMap | None
    color: np.ndarray  # (3,): colour that tells the parts apart, 0 to 255
    shape: str  # shape of its samples, which does so without colour

    @property
    def rows(self) -> Indices:
        """Samples that are drawn."""
        return thinned(len(self.survey), MAX_SHOWN)


@dataclass(frozen=True, eq=False, slots=True)
class Exhibit:
    """Everything that a viewer shows."""

    parts: tuple[Part, ...]  # with a registration: base and target
    # Pose of the target's frame in the base's; the best candidate if none was accepted
    T_base_target: RigidTransform | None
    result: RegistrationResult | None
    # (float, float), uT: range of the colour scale of field magnitudes, common to all parts
    limits: tuple[float, float]

    @property
    def words(self) -> list[str]:
        """Description of the picture."""
        said = [] if self.result is None else [headline(self.result) + ".", self.result.reason + "."]
        said += [f"{part.name}: {_described(part)}." for part in self.parts]
        low, high = self.limits
        return [*said, f"Shades of field magnitude go from {low:.3g} uT (dark) to {high:.3g} uT (light)."]

    def pose_of_target(self, share: float) -> RigidTransform:
        """Where the target's frame stands on the way from as it was recorded (0) to registered (1)."""
        if self.T_base_target is None:
            return RigidTransform.identity()
        ends = np.stack([np.eye(3), rotation_matrix(self.T_base_target)])
        turn = Slerp([0.0, 1.0], type(self.T_base_target.rotation).from_matrix(ends))(share)
        return RigidTransform.from_components(share * self.T_base_target.translation, turn)

    def links(self, share: float) -> np.ndarray:
        """Both ends of every link in the base's frame, (n, 2, 3), with the target where `pose_of_target` has it."""
        if self.result is None:
            return np.zeros((0, 2, 3), dtype=np.float32)
        rows, ends = thinned(len(self.result.links.base), MAX_LINKS), self.result.links
        moved = self.pose_of_target(share).apply(ends.target[rows])
        return np.stack([ends.base[rows], moved], axis=1).astype(np.float32)


def exhibit(drawn: Sequence[Survey | FieldMap], result: RegistrationResult | None = None) -> Exhibit:
    """Assemble what a viewer shows; with a result, its base and its target."""
    surveys = [survey_of(item) for item in drawn]
    names = ["base", "target"] if result is not None else _unique([survey.name for survey in surveys])
    colors = np.array([[0, 54, 95], [213, 94, 0], [87, 96, 106], [0, 158, 115], [204, 121, 167]])
    parts = tuple(
        Part(
            name,
            survey,
            item if isinstance(item, FieldMap) else None,
            colors[k % len(colors)],
            SHAPES[k % len(SHAPES)],
        )
        for k, (name, survey, item) in enumerate(zip(names, surveys, drawn, strict=True))
    )
    limits = common_limits(*(magnitude_ut(survey.field) for survey in surveys))
    return Exhibit(parts, None if result is None else shown_pose(result), result, limits)


def shaded(values: Scalars, limits: tuple[float, float]) -> Matrix:
    """Colours of numbers: (n, 3), 0 to 255."""
    low, high = limits
    place = np.clip((values - low) / (high - low), 0, 1) * (len(SHADES) - 1)
    return np.stack([np.interp(place, np.arange(len(SHADES)), channel) for channel in SHADES.T], axis=1)


def cut_colors(field_map: FieldMap, cut: Cut, quantity: str, limits: tuple[float, float]) -> tuple[Matrix, Mask]:
    """Colours of a map on a cut, (n, 3) from 0 to 255 row by row, and where it knows the field."""
    field, is_known = field_on(cut, field_map)
    if quantity == "field magnitude":
        return shaded(magnitude_ut(field), limits), is_known
    variance = np.trace(field_map.covariance(cut.points), axis1=1, axis2=2) / 3
    sd = UT_PER_TESLA * np.sqrt(np.maximum(variance, 0))
    return shaded(sd, (0.0, common_limits(sd[is_known])[1])), is_known


def box_of(shown: Exhibit) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of all parts, the target where it belongs, base frame."""
    p = [part.survey.positions[thinned(len(part.survey), 2000)] for part in shown.parts]
    if shown.T_base_target is not None:
        p[-1] = shown.T_base_target.apply(p[-1])
    everything = np.concatenate(p)
    return everything.min(axis=0), everything.max(axis=0)


def _described(part: Part) -> str:
    n, n_drawn = len(part.survey), len(part.rows)
    drawn = "" if n == n_drawn else f", {n_drawn} drawn"
    return f"{part.survey.name}, {n} samples{drawn}" + (", with its map" if part.field_map is not None else "")


def _unique(names: list[str]) -> list[str]:
    """Names of nodes: without slashes, which would nest them, and numbered where they repeat."""
    clean = [name.replace("/", "_") or "survey" for name in names]
    return [name if clean.count(name) == 1 else f"{name} {k + 1}" for k, name in enumerate(clean)]
