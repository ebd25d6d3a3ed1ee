# SPDX-License-Identifier: BSD-3-Clause
"""Structures make indoor fields: steel around a room or a corridor, magnets under a table."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from magmatch.simulation.magnets import Cuboid, Cylinder, Source, field_of
from magmatch.typing import Points, Vector3

# Sources per square metre of wall, floor and ceiling: cabinets, girders, pipes and rebar of an office.
SOURCES_PER_AREA = 0.6
# Half of what steel shows indoors follows the Earth's field (mid-latitude dip), the other half is remanent.
_INDUCED = 0.5 * np.array([0.37, 0.0, -0.93])

# Least and largest sides (along the wall twice, then behind it), m, and strength against a cabinet's: what is small
# is a motor or a loudspeaker, with magnets of its own.
_BODIES = {
    "cabinet": ((0.4, 0.5, 0.2), (0.8, 1.2, 0.5), 1.0),
    "girder": ((1.0, 0.1, 0.1), (2.0, 0.2, 0.2), 2.0),
    "motor": ((0.1, 0.1, 0.1), (0.25, 0.25, 0.2), 4.0),
}


def around_box(
    low: Vector3, high: Vector3, clearance: float, rng: np.random.Generator, faces: Sequence[int] = range(6)
) -> list[Source]:
    """Structures on the walls, floor and ceiling around a box, none nearer to it than the clearance."""
    sides = high - low
    area = np.array([np.prod(np.delete(sides, face // 2)) for face in faces])
    n = max(int(np.ceil(SOURCES_PER_AREA * area.sum())), 6)
    sources = []
    for face in rng.choice(np.asarray(faces), n, p=area / area.sum()):
        axis, outward = int(face) // 2, 1.0 if face % 2 else -1.0
        normal = np.zeros(3)
        normal[axis] = outward
        foot = rng.uniform(low - 0.3, high + 0.3)
        foot[axis] = (high if outward > 0 else low)[axis]
        sources.append(_against_wall(foot + normal * (clearance + rng.exponential(0.2)), normal, rng))
    return sources


def inside_box(low: Vector3, high: Vector3, n: int, rng: np.random.Generator) -> list[Source]:
    """Furniture that stands in the surveyed box itself."""
    sources: list[Source] = []
    for _ in range(n):
        size = rng.uniform((0.2, 0.2, 0.2), (0.5, 0.5, 0.6))
        reach = np.hypot(size[0], size[1])
        margin = np.minimum(np.array([reach, reach, size[2]]), high - low) / 2
        rotation = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
        sources.append(Cuboid(rng.uniform(low + margin, high - margin), size, _polarization(rotation, rng), rotation))
    return sources


def under_table(size: tuple[float, float], depth: float, n: int, rng: np.random.Generator) -> list[Source]:
    """Block magnets of varying strength fixed under a table top."""
    sources: list[Source] = []
    half = np.array(size) / 2 - 0.05
    for _ in range(n):
        center = np.array([*rng.uniform(-half, half), -depth])
        rotation = Rotation.from_euler("zx", [rng.uniform(-np.pi, np.pi), rng.choice([0.0, np.pi])])
        remanence = rng.uniform(0.15, 0.4)
        tilt = rng.normal(scale=0.1, size=2)
        sources.append(
            Cuboid(
                center,
                rng.uniform((0.012, 0.012, 0.004), (0.025, 0.02, 0.006)),
                remanence * np.array([tilt[0], tilt[1], 1.0]),
                rotation,
            )
        )
    return sources


def along_corridor(
    place: Callable[[np.ndarray], tuple[Points, np.ndarray]],
    length: float,
    half_width: float,
    rng: np.random.Generator,
) -> list[Source]:
    """Structures in the walls, floor and ceiling along a corridor, about one in each of them per metre and a half."""
    n = int(np.ceil(length / 0.4))
    floor, heading = place(rng.uniform(0, length, n))
    left = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(n)])
    up = np.array([0.0, 0.0, 1.0])
    sources = []
    for k, surface in enumerate(rng.integers(0, 4, n)):
        if surface < 2:
            normal = left[k] * (1.0 if surface else -1.0)
            foot = floor[k] + normal * half_width + up * rng.uniform(0.1, 2.2)
        else:
            normal = up if surface == 2 else -up
            foot = (
                floor[k] + left[k] * rng.uniform(-half_width, half_width) + (2.5 * up if surface == 2 else -0.1 * up)
            )
        sources.append(_against_wall(foot + normal * rng.exponential(0.1), normal, rng))
    return sources


def calibrated(sources: Sequence[Source], probes: Points, anomaly_sd: float) -> list[Source]:
    """Give the sources, strengthened together until the field varies as much as wanted."""
    field = field_of(sources, probes)
    factor = anomaly_sd / float(np.sqrt(((field - field.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return [source.strengthened(factor) for source in sources]


def is_clear(sources: Sequence[Source], points: Points, clearance: float) -> np.ndarray:
    """Whether each point keeps its distance from all sources: (n,) bool."""
    clear = np.ones(len(points), dtype=bool)
    for source in sources:
        clear &= source.distance_to(points) >= clearance
    return clear


def rearranged(
    sources: Sequence[Source], fraction: float, points: Points, clearance: float, rng: np.random.Generator
) -> list[Source]:
    """Give the sources after some were moved, each by 0.3 to 0.8 m, none closer to the samples than the clearance."""
    after = list(sources)
    for k in rng.permutation(len(after))[: round(fraction * len(after))]:
        least = min(clearance, float(after[k].distance_to(points).min()))
        for _ in range(100):
            direction = rng.standard_normal(3)
            shift = rng.uniform(0.3, 0.8) * direction / np.linalg.norm(direction)
            moved = replace(after[k], center=after[k].center + shift)
            if moved.distance_to(points).min() >= least:
                after[k] = moved
                break
    return after


def _against_wall(foot: Vector3, normal: Vector3, rng: np.random.Generator) -> Source:
    """Put a structure behind a wall: its nearest face touches `foot`, `normal` points away from the room."""
    aside = np.roll(normal, 1)
    aside = np.cross(normal, aside)
    aside /= np.linalg.norm(aside)
    spin = rng.normal(scale=0.15) + rng.choice([0.0, np.pi / 2])
    u = np.cos(spin) * aside + np.sin(spin) * np.cross(normal, aside)
    v = np.cross(normal, u)
    kind = str(rng.choice(("cabinet", "girder", "pipe", "motor"), p=(0.35, 0.25, 0.25, 0.15)))
    if kind == "pipe":
        rotation = Rotation.from_matrix(np.column_stack([v, normal, u]))
        diameter, length = rng.uniform((0.05, 0.6), (0.2, 2.0))
        return Cylinder(foot + normal * diameter / 2, diameter, length, _polarization(rotation, rng), rotation)
    rotation = Rotation.from_matrix(np.column_stack([u, v, normal]))
    smallest, largest, strength = _BODIES[kind]
    size = rng.uniform(smallest, largest)
    return Cuboid(foot + normal * size[2] / 2, size, strength * _polarization(rotation, rng), rotation)


def _polarization(rotation: Rotation, rng: np.random.Generator) -> Vector3:
    """Draw a polarisation of steel, body frame, T (order of magnitude; the room is calibrated as a whole)."""
    along = _INDUCED + rng.standard_normal(3) / np.sqrt(3) / 2
    return np.asarray(2e-4 * rng.lognormal(0, 0.7) * rotation.inv().apply(along))
