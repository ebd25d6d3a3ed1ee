# SPDX-License-Identifier: BSD-3-Clause
"""Settings of keypoints, local frames and descriptors; the defaults are the published ones where it prints any."""

from typing import Literal

from pydantic import Field

from magmatch.settings import Settings


class FeatureConfig(Settings):
    """The settings of where a map is asked, which points are kept, and how their surroundings are described."""

    # Where X* lies: a grid within the samples' hull, or near the path of a robot; 'auto' looks how much of the hull
    # lies near a sample.
    grid: Literal["auto", "region", "path"] = "auto"
    # Axes of the grid: the survey's own (published), but for the normal of a flat survey; or the principal axes of
    # its samples, with which features do not depend on the frame.
    axes: Literal["survey", "principal"] = "survey"
    # Distance of the points of X*, m, used as stated or refused. None: `spacing_in_lengthscales`, coarser where
    # `max_points` asks for it.
    spacing: float | None = Field(default=None, gt=0)
    # Experiment: 0.13 to 0.2 do alike.
    spacing_in_lengthscales: float = Field(default=0.16, gt=0)
    # Most points of X*; bounds time and memory.
    max_points: int = Field(default=40_000, ge=100)
    # How far from the path X* reaches where it follows one, spacings.
    path_radius: float = Field(default=3.0, gt=0)
    # Of the points above the mean response, the share with the lowest posterior variance that is kept.
    variance_quantile: float = Field(default=0.9, gt=0, le=1)
    # Or the largest posterior variance of a keypoint's field, T^2, asked at each point as published.
    max_variance: float | None = Field(default=None, gt=0)
    # Radius of a keypoint's support, spacings (published: 4).
    support_radius: float = Field(default=4.0, ge=1)
    # Standard deviation of the Gaussian that weighs the support for the local frame, spacings.
    frame_sd: float = Field(default=2.0, gt=0)
    # Keypoints whose weighted sum of projected vectors is below this share of the sum of their norms are dropped:
    # their x-axis is noise.
    min_frame_strength: float = Field(default=0.05, ge=0, lt=1)
    # Half range of the component histograms, T. None: scaled to the data; the printed case is 0.01 (100 G).
    component_range: float | None = Field(default=None, gt=0)
