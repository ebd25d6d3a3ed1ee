# SPDX-License-Identifier: BSD-3-Clause
"""The content of a survey, in plain numbers and words for a reader."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from magmatch.data.checks import check_survey, extent, time_gaps
from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey import Survey, has_order


def describe(survey: Survey, layout: SurveyFormat | None = None, parts: Sequence[Survey] = ()) -> dict[str, Any]:
    """Counts, extent, units, frames, gaps and warnings of a survey, ready for JSON.

    ``time`` is None without times; ``path_length`` and ``median_step`` are None where the rows are not a path. The
    way from one of the ``parts``, surveys that were joined to this one, to the next belongs to no path.
    """
    warnings = check_survey(survey, layout)
    magnitude = np.linalg.norm(survey.field, axis=1)
    # Of rows in no order a path length would be a number without meaning.
    paths = parts or (survey,)
    is_ordered = all(map(has_order, paths))
    steps = np.concatenate([np.linalg.norm(np.diff(path.positions, axis=0), axis=1) for path in paths])
    return {
        "name": survey.name,
        "samples": len(survey),
        "units": {"length": "m", "field": "T", "time": "s"},
        "frame": survey.frame,
        "orientations": survey.orientations is not None,
        "pose_sd": survey.pose_sd,
        "low": survey.positions.min(axis=0).tolist(),
        "high": survey.positions.max(axis=0).tolist(),
        "extent": extent(survey).tolist(),
        "ordered": is_ordered,
        "path_length": float(steps.sum()) if is_ordered else None,
        "median_step": float(np.median(steps)) if is_ordered else None,
        "field": {
            "median_magnitude": float(np.median(magnitude)),
            "smallest_magnitude": float(magnitude.min()),
            "largest_magnitude": float(magnitude.max()),
            "mean": survey.field.mean(axis=0).tolist(),
            "sd": survey.field.std(axis=0).tolist(),
        },
        "time": _describe_times(survey),
        "warnings": warnings,
    }


def _describe_times(survey: Survey) -> dict[str, Any] | None:
    """Span, rate and gaps; None without times."""
    if survey.times is None:
        return None
    gaps = time_gaps(survey)
    return {
        "first": float(survey.times[0]),
        "last": float(survey.times[-1]),
        "duration": float(survey.times[-1] - survey.times[0]),
        "rate": float(1 / np.median(np.diff(survey.times))),
        "gaps": len(gaps),
        "longest_gap": float(gaps.max()) if len(gaps) else 0.0,
    }
