# SPDX-License-Identifier: BSD-3-Clause
"""The named scenarios: which sources stand where, how both sensors are carried, and the frames of the surveys."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.errors import ConfigurationError
from magmatch.geometry import path_walked, random_transform
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.magnets import Source
from magmatch.simulation.paths import (
    SensorPath,
    around_loop,
    boustrophedon,
    circles,
    heading_along,
    loop_length,
    smooth_noise,
    upright,
    wander,
)
from magmatch.simulation.scene import Scene, Streams
from magmatch.simulation.structures import (
    along_corridor,
    around_box,
    calibrated,
    inside_box,
    is_clear,
    rearranged,
    under_table,
)
from magmatch.typing import Points, Vector3

TABLE_SIZE = (2.0, 1.5)  # m; 3 m^2 as published
TABLE_MAGNET_DEPTH = 0.08  # m under the surface: top and spacer, so that rows resolve what lies under them
TABLE_ROW_SPACING = 0.07  # m
ROBOT_HEIGHT = 0.05  # m above the table, as published
TABLE_HEIGHTS = (ROBOT_HEIGHT, 0.10, 0.15)  # m above the surface
LOOP_SIZE = (20.0, 10.0)  # m, sides of the corridor's centre line
LOOP_CORNER = 1.0  # m, radius a robot turns with
CORRIDOR_HALF_WIDTH = 1.0  # m
CORRIDOR_STRETCH = 25.0  # m walked twice; longer than a side, so that it always holds a corner
INSIDE_CLEARANCE = 0.15  # m between a sample and the furniture it passes
N_PROBES = 300
SAMPLE_INTERVAL = 0.05  # s, of sensors that are carried about a room
ATTITUDE_SD = np.deg2rad(25)  # of the tilt of a sensor that is waved about by hand

Builder = Callable[[SimulationConfig, Streams], Scene]


def build_scene(scenario: str, config: SimulationConfig, streams: Streams) -> Scene:
    """Build a named scenario: all that is true, nothing measured."""
    if scenario not in SCENARIOS:
        msg = f"no scenario '{scenario}'; there are {', '.join(SCENARIOS)}"
        raise ConfigurationError(msg)
    scene = SCENARIOS[scenario](config, streams)
    if not config.moved_sources:
        return scene
    samples = np.concatenate([scene.base_path.positions, scene.target_path.positions])
    moved = rearranged(scene.target_sources, config.moved_sources, samples, config.clearance, streams.moves)
    # Where most of a place is gone, refusing is right.
    return replace(scene, target_sources=tuple(moved), accept=scene.accept and config.moved_sources <= 0.5)


def _room(
    config: SimulationConfig,
    streams: Streams,
    frame: RigidTransform | str,
    *,
    overlap: float = 1.0,
    n_inside: int = 0,
) -> Scene:
    """Build a room with structures around it (and in it), both surveys random samples of a box."""
    overlap = overlap if config.overlap is None else config.overlap
    sides = np.array(config.room_size)
    shift = np.array([(1 - overlap) * sides[0], 0.0, 0.0])
    low = -(sides + shift) / 2
    furniture = inside_box(low, -low, n_inside, streams.sources)
    sources = around_box(low, -low, config.clearance, streams.sources) + furniture
    probes = _samples(low, -low, furniture, N_PROBES, streams.probes)
    sources = calibrated(sources, probes, config.anomaly_sd)
    base = SensorPath(_samples(low, low + sides, furniture, config.n_samples, streams.base))
    target = SensorPath(_samples(low + shift, -low, furniture, config.n_samples, streams.target))
    return _scene(config, streams, sources, base, target, frame)


def _room_turned(config: SimulationConfig, streams: Streams, *, axis: str, angle_deg: float) -> Scene:
    """Build the published office: the target's axes turned by a known angle, its origin half a metre away."""
    offset = streams.frames.uniform(-0.5, 0.5, 3)
    rotation = Rotation.from_euler(axis, angle_deg, degrees=True)
    return _room(config, streams, RigidTransform.from_components(offset, rotation).inv())


def _nowhere(config: SimulationConfig, streams: Streams) -> Scene:
    """Two rooms of one kind that are different places: there is nothing to find."""
    scene = _room(config, streams, "any")
    high = np.array(config.room_size) / 2
    others = around_box(-high, high, config.clearance, streams.elsewhere)
    others = calibrated(others, streams.probes.uniform(-high, high, (N_PROBES, 3)), config.anomaly_sd)
    return replace(scene, target_sources=tuple(others), accept=False)


def _uniform(config: SimulationConfig, streams: Streams) -> Scene:
    """Earth's field and noise only: any translation and any turn about the field explains the data."""
    high = np.array(config.room_size) / 2
    base = SensorPath(streams.base.uniform(-high, high, (config.n_samples, 3)))
    target = SensorPath(streams.target.uniform(-high, high, (config.n_samples, 3)))
    return replace(_scene(config, streams, [], base, target, "any"), accept=False)


def _repeated(config: SimulationConfig, streams: Streams) -> Scene:
    """Three equal rooms in a row for the base, the middle one for the target: three answers are equally good."""
    high = np.array(config.room_size) / 2
    pattern = around_box(-high, high, config.clearance, streams.sources, faces=(2, 3, 4, 5))
    # Copies beyond the base's ends, so that the row's own ends do not tell the rooms apart.
    steps = [np.array([2 * high[0] * k, 0.0, 0.0]) for k in range(-4, 5)]
    sources = [replace(source, center=source.center + step) for step in steps for source in pattern]
    sources = calibrated(sources, streams.probes.uniform(-high, high, (N_PROBES, 3)), config.anomaly_sd)
    three = high * (3.0, 1.0, 1.0)
    base = SensorPath(streams.base.uniform(-three, three, (config.n_samples, 3)))
    target = SensorPath(streams.target.uniform(-high, high, (config.n_samples, 3)))
    return replace(_scene(config, streams, sources, base, target, "any"), accept=False)


def _planar(config: SimulationConfig, streams: Streams) -> Scene:
    """Two planes, one above the other, held to a centimetre."""
    scene = _room(config, streams, "any")

    def flattened(path: SensorPath, height: float, rng: np.random.Generator) -> SensorPath:
        z = height + 0.01 * rng.uniform(-1, 1, len(path.positions))
        return SensorPath(np.column_stack([path.positions[:, :2], z]))

    return replace(
        scene,
        base_path=flattened(scene.base_path, -config.plane_gap / 2, streams.base),
        target_path=flattened(scene.target_path, config.plane_gap / 2, streams.target),
    )


def _carried(config: SimulationConfig, streams: Streams, *, is_level: bool) -> Scene:
    """Build a room filled by hand, with all headings and tilts of 25 degrees, or by a robot at one height, level."""
    size, tilt_sd = config.room_size, ATTITUDE_SD
    if is_level:
        size, tilt_sd = (size[0], size[1], 0.0), 0.0
    room = _room(config.model_copy(update={"target_frame": "scenario"}), streams, RigidTransform.identity())

    def walk(rng: np.random.Generator) -> SensorPath:
        n = config.n_samples
        positions = wander(size, n, SAMPLE_INTERVAL, rng)
        tilt = np.column_stack([smooth_noise(n, 12, tilt_sd, rng) for _ in range(3)])
        ahead = np.unwrap(heading_along(positions))
        orientations = upright(ahead) * Rotation.from_rotvec(tilt)
        return SensorPath(positions, SAMPLE_INTERVAL * np.arange(n), orientations)

    return _scene(config, streams, list(room.base_sources), walk(streams.base), walk(streams.target), "any")


def _table(config: SimulationConfig, streams: Streams) -> Scene:
    """A table swept along its length for the base and across it for the target, with the sensor held askew.

    The target's frame is its first sensor pose, so the truth is that pose in the table's frame.
    """
    askew = Rotation.from_euler("ZY", [20.0, 20.0], degrees=True)
    base = _hand_held_sweep(0, Rotation.identity(), config.n_samples, streams.base)
    target = _hand_held_sweep(1, askew, config.n_samples, streams.target)
    return _scene(config, streams, _magnets(streams), base, target, "first_pose")


def _table_robot(config: SimulationConfig, streams: Streams) -> Scene:
    """A robot drives circles near the table's centre at a fixed height, to be found in the table's map."""
    base = _hand_held_sweep(0, Rotation.identity(), config.n_samples, streams.base)
    center = np.array([*streams.target.uniform(-0.1, 0.1, 2), ROBOT_HEIGHT])
    positions = circles(center, (0.25, 0.4, 0.55), 2, config.n_samples)
    target = SensorPath(positions, path_walked(positions) / 0.2, upright(heading_along(positions)))
    return _scene(config, streams, _magnets(streams), base, target, "any")


def _corridor(config: SimulationConfig, streams: Streams) -> Scene:
    """A stretch of a corridor loop walked twice, 0.1 to 0.4 m apart, by dead reckoning in two frames."""
    length, place = loop_length(LOOP_SIZE, LOOP_CORNER), partial(around_loop, LOOP_SIZE, LOOP_CORNER)
    sources = along_corridor(place, length, CORRIDOR_HALF_WIDTH, streams.sources)
    start, phase = streams.sources.uniform(0, length), streams.sources.uniform(0, 2 * np.pi)

    def walk(side: float, begin: float, end: float) -> SensorPath:
        s = np.linspace(begin, end, config.n_samples)
        positions, heading = place(start + s)
        apart = 0.25 + 0.15 * np.sin(2 * np.pi * s / 12 + phase)
        positions += (side * apart / 2)[:, None] * np.column_stack([-np.sin(heading), np.cos(heading), 0 * s])
        positions[:, 2] = 0.5
        return SensorPath(positions, path_walked(positions) / 0.5, upright(heading_along(positions)))

    base = walk(-1.0, 0.0, CORRIDOR_STRETCH)
    early, late = streams.target.uniform(0, 1, 2)
    target = walk(1.0, early, CORRIDOR_STRETCH - late)
    probes, _ = place(start + np.linspace(0, CORRIDOR_STRETCH, N_PROBES))
    probes[:, 2] = 0.5
    sources = [source for source in sources if is_clear([source], probes, 0.5).all()]
    sources = calibrated(sources, probes, config.anomaly_sd)
    scene = _scene(config, streams, sources, base, target, "yaw")
    return replace(scene, T_base_world=_frame("yaw", base, streams.frames), is_blind=True)


def _scene(
    config: SimulationConfig,
    streams: Streams,
    sources: list[Source],
    base: SensorPath,
    target: SensorPath,
    frame: RigidTransform | str,
) -> Scene:
    """Put a scene together: the base's frame is the world, the target's the scenario's choice or the config's."""
    if config.target_frame != "scenario":
        frame = config.target_frame
    if config.target_turn is not None:
        frame = _turned_by(config.target_turn, streams.frames)
    T_target_world = _frame(frame, target, streams.frames) if isinstance(frame, str) else frame
    everything, earth_field = tuple(sources), np.array(config.earth_field)
    return Scene(everything, everything, base, target, RigidTransform.identity(), T_target_world, earth_field)


def _frame(kind: str, path: SensorPath, rng: np.random.Generator) -> RigidTransform:
    """Draw a survey frame: takes world coordinates to it."""
    if kind == "yaw":
        turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
        return RigidTransform.from_components(rng.uniform(-5, 5, 3), turn)
    if kind == "any":
        return random_transform(rng)
    if path.orientations is None:
        msg = "target_frame 'first_pose' needs a scenario whose target is a path: table, table-robot or corridor"
        raise ConfigurationError(msg)
    return RigidTransform.from_components(path.positions[0], path.orientations[0]).inv()


def _turned_by(angle: float, rng: np.random.Generator) -> RigidTransform:
    """Draw a survey frame that is turned by a given angle: takes world coordinates to it."""
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    return RigidTransform.from_components(rng.uniform(-5, 5, 3), turn)


def _samples(low: Vector3, high: Vector3, furniture: list[Source], n: int, rng: np.random.Generator) -> Points:
    """Random points of a box that keep off its furniture."""
    points = rng.uniform(low, high, (n, 3))
    while not (free := is_clear(furniture, points, INSIDE_CLEARANCE)).all():
        points[~free] = rng.uniform(low, high, (int((~free).sum()), 3))
    return points


def _magnets(streams: Streams) -> list[Source]:
    """Draw the magnets of the table."""
    return under_table(TABLE_SIZE, TABLE_MAGNET_DEPTH, int(streams.sources.integers(10, 21)), streams.sources)


def _hand_held_sweep(along: int, held: Rotation, n: int, rng: np.random.Generator) -> SensorPath:
    """Sweep the table in rows by hand: centimetre wander and two degrees of wobble about how the sensor is held."""
    high = np.array([*TABLE_SIZE, 0.0]) / 2
    positions = boustrophedon(-high, high, TABLE_HEIGHTS, TABLE_ROW_SPACING, along, n)
    positions += np.column_stack([smooth_noise(n, 10, sd, rng) for sd in (0.01, 0.01, 0.005)])
    wobble = np.column_stack([smooth_noise(n, 15, np.deg2rad(2), rng) for _ in range(3)])
    # The first pose defines the target's frame: held exactly as the scenario says.
    return SensorPath(positions, path_walked(positions) / 0.25, held * Rotation.from_rotvec(wobble - wobble[0]))


SCENARIOS: dict[str, Builder] = {
    **dict.fromkeys(("office", "office-z30"), partial(_room_turned, axis="z", angle_deg=30.0)),
    "office-x30": partial(_room_turned, axis="x", angle_deg=-30.0),
    "office-random": partial(_room, frame="any"),
    "office-overlap": partial(_room, frame="any", overlap=0.5),
    "office-inside": partial(_room, frame="any", n_inside=5),
    "office-hand-held": partial(_carried, is_level=False),
    "office-robot": partial(_carried, is_level=True),
    "planar": _planar,
    "table": _table,
    "table-robot": _table_robot,
    "corridor": _corridor,
    "repeated": _repeated,
    "nowhere": _nowhere,
    "uniform": _uniform,
}
