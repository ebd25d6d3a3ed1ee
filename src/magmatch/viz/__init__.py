# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of surveys, maps and results; computes nothing itself. Needs the extra 'viz'."""

from magmatch.registration.result import Links
from magmatch.viz.figures.published_figures import (
    curvature_figure,
    linked_keypoints_figure,
    local_frames_figure,
    published_figures,
)

__all__ = ["Links", "curvature_figure", "linked_keypoints_figure", "local_frames_figure", "published_figures"]
