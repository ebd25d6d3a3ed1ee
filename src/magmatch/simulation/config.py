# SPDX-License-Identifier: BSD-3-Clause
"""Settings of a simulation: one flat list that every scenario reads what it needs from."""

from typing import Literal

from pydantic import Field

from magmatch.settings import Settings


class SimulationConfig(Settings):
    """The settings of a simulated pair of surveys; scenario-independent unless a comment says otherwise."""

    # Samples in each survey (the published office used a few thousand).
    n_samples: int = Field(default=2500, ge=4, le=10_000_000)
    # Noise of one field component, T; 0.3 to 0.5 uT is what calibrated MEMS magnetometers show.
    noise_sd: float = Field(default=0.4e-6, ge=0)
    # White noise of each position coordinate as recorded, m; the field is that of the true position.
    pose_noise_sd: float = Field(default=0.0, ge=0)
    # Random walk of the recorded horizontal positions, m per sqrt(m) walked; `corridor` only, whose surveys are
    # walked blind. 0.01 leaves 2 cm over 25 m, as after a SLAM's own correction.
    pose_drift: float = Field(default=0.01, ge=0)
    # The target's magnetometer reads (1 + scale) b + bias, sensor frame (survey frame where it did not turn), T.
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = Field(default=0.0, gt=-1)
    # Fraction of the sources that stand elsewhere, 0.3 to 0.8 m away, when the target is surveyed.
    moved_sources: float = Field(default=0.0, ge=0, le=1)
    # Fraction of the target's region that the base covers too; rooms only. None: the scenario's own.
    overlap: float | None = Field(default=None, gt=0, le=1)
    # The target's frame: the scenario's own choice, turned about the vertical, any SE(3), or its first sensor pose
    # (which needs a path).
    target_frame: Literal["scenario", "yaw", "any", "first_pose"] = "scenario"
    # Angle by which the target's axes are turned, about an axis drawn at random, rad. None: as the frame above says.
    target_turn: float | None = Field(default=None, ge=0, le=3.141592653589793)
    # Distance of the two surveys' planes, m; `planar` only.
    plane_gap: float = Field(default=0.1, ge=0)
    # Sides of the surveyed box of the rooms, m (the published office: a room).
    room_size: tuple[float, float, float] = (3.0, 3.0, 1.0)
    # Least distance of a sample to a structure of a room, m: what furniture lets a hand-held sensor do.
    clearance: float = Field(default=0.3, gt=0)
    # Root mean square deviation of the field vector over the surveyed region, T; indoors 10 to 20 uT. `table` takes
    # its magnets as they are.
    anomaly_sd: float = Field(default=15e-6, gt=0)
    # Earth's field in the scenario's world (x east, z up), T: mid-latitude, 48 uT.
    earth_field: tuple[float, float, float] = (17.83e-6, 0.0, -44.57e-6)
