# SPDX-License-Identifier: BSD-3-Clause
"""The graph's state in the terms of the result: closures of bodies, estimated odometry, and words."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch.data.geodesy import Origin
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import frame_about
from magmatch.field.map import FieldMap
from magmatch.geometry import adjoint
from magmatch.number_text import many
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.graph.factors import Closure
from magmatch.slam.graph.learned_drift import teaches_drift
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.result import AnchorResult, ClosureResult, DriftResult, LogOdometry, Recalibration, SlamStatus
from magmatch.slam.sensor_bias import recalibrations_of
from magmatch.slam.windows import Path, Window
from magmatch.typing import Covariance6, Vector3

# Of a magnetometer in its own axes, and sd, T.
Bias = tuple[Vector3, Vector3]


def state_closure(
    closure: Closure, graph: PoseGraph, paths: Sequence[Path], names: Sequence[str], *, is_rigid: bool
) -> ClosureResult:
    """A closure between nodes as one between bodies; between rigid surveys, as one between their frames."""
    sides = [(int(graph.log[node]), node) for node in (closure.first, closure.second)]
    (T_a, t_a, walked_a), (T_b, t_b, walked_b) = (body_at(paths[log], node, is_rigid=is_rigid) for log, node in sides)
    M = adjoint(T_b.inv())
    return ClosureResult(
        names[sides[0][0]],
        t_a,
        names[sides[1][0]],
        t_b,
        T_a.inv() * closure.T_first_second * T_b,
        M @ closure.covariance @ M.T,
        float(1 / (1 + np.exp(-closure.log_odds))),
        float(closure.weight) if closure.is_kept else 0.0,
        walked_a,
        walked_b,
    )


def body_at(path: Path, node: int, *, is_rigid: bool) -> tuple[RigidTransform, float | None, float]:
    """Body in the axes of a node, when it was there, and how far it had walked; of a rigid survey, its frame."""
    window = node - path.first_node
    if is_rigid:
        return path.windows[window].T_log_node.inv(), None, 0.0
    at, survey = int(path.middles[window]), path.survey
    R = None if survey.orientations is None else survey.orientations[at]
    T = RigidTransform.identity() if R is None else RigidTransform.from_rotation(R)
    return T, None if survey.times is None else float(survey.times[at]), float(path.walked[at])


def state_anchors(
    anchors: Sequence[tuple[Anchor, int]], graph: PoseGraph, names: Sequence[str]
) -> tuple[AnchorResult, ...]:
    """Fixed points, each with its log's number, and the residuals of the log there."""
    residuals = zip(anchors, graph.off_fixed(), *graph.off_fixed_without(), strict=True)
    return tuple(
        AnchorResult(
            names[of], a.t, a.position.tolist(), a.sd, off.tolist(), without.tolist(), float(np.sqrt(np.trace(C) / 3))
        )
        for (a, of), off, without, C in residuals
    )


def state_odometry(
    graph: PoseGraph, biases: Sequence[Bias], in_maps: Sequence[Bias], logs: Sequence[Survey], names: Sequence[str]
) -> DriftResult:
    """The drift of the odometry, and each log's constant errors.

    A bias is what the graph began with and the map's part, which knows it better.
    """
    biases = [
        (first + more, sd if sd.any() else first_sd)
        for (first, first_sd), (more, sd) in zip(biases, in_maps, strict=True)
    ]
    each = zip(names, graph.lasting.tolist(), biases, map(_state_recalibrations, logs), strict=True)
    return DriftResult(
        sd=graph.config.odometry.sd,
        logs={
            name: LogOdometry(
                scale=float(np.expm1(scale)), turn_rate=rate, bias=bias.tolist(), bias_sd=sd.tolist(),
                recalibrations=found,
            )
            for name, (scale, rate), (bias, sd), found in each
        },
    )  # fmt: skip


def _state_recalibrations(survey: Survey) -> list[Recalibration]:
    found = recalibrations_of(survey)
    if survey.times is None:
        return []
    return [
        Recalibration(t=t, step=step)
        for t, step in zip(survey.times[found.rows].tolist(), found.steps.tolist(), strict=True)
    ]


def biases_in_maps(maps: Mapping[int, FieldMap], components: Sequence[Sequence[int]], n: int) -> list[Bias]:
    """What maps, by their component, know of the bias that each of n logs still has."""
    found = [(np.zeros(3), np.zeros(3)) for _ in range(n)]
    for component, made in maps.items():
        logs = components[component]
        if made.biases is not None and len(made.surveys) == len(logs):
            for k, bias, sd in zip(logs, made.biases.bias, made.biases.sd, strict=True):
                found[k] = bias, sd
    return found


def bent_window(windows: Sequence[Window]) -> Window | None:
    """One of the windows, if none keeps its shape."""
    return None if any(w.keeps_shape for w in windows) else next(iter(windows), None)


def guessed_drift(graph: PoseGraph, stated: SlamConfig, logs: Sequence[Survey]) -> tuple[float, float] | None:
    """The drift of some log that was neither stated nor learned, m and deg in 10 m."""
    is_stated = stated.odometry.sd != OdometryConfig().sd or all(stated.sd_stated(s.name) is not None for s in logs)
    return None if is_stated or teaches_drift(graph) else stated.odometry.sd


def frame_of(component: int, origin: tuple[float, float] | None) -> str:
    """Name of a component's frame: as readers of degrees name it, where fixed points tie it to an origin."""
    if origin is not None:
        return frame_about(Origin(*origin))
    return f"map_{component + 1}" if component else "map"


def place_and_turn(C: Covariance6) -> tuple[float, float]:
    """Standard deviations of a pose, m and rad, of all directions together."""
    place, turn = (float(np.sqrt(max(np.trace(block), 0.0))) for block in (C[3:, 3:], C[:3, :3]))
    return place, turn


def explain(
    status: SlamStatus,
    groups: Sequence[Sequence[str]],
    n_kept: int,
    n_rejected: int,
    n_fixed: int = 0,
    bent: Window | None = None,
    guessed: tuple[float, float] | None = None,
    bent_logs: Sequence[str] = (),
    *,
    is_rigid: bool = False,
) -> str:
    """Say in words how the logs are connected, or how they could be; or name a window that does not keep its shape.

    ``guessed``: the drift (m, deg) that was neither stated nor learned. ``bent_logs``: those that were corrected by
    more than it makes possible. ``is_rigid``: they are surveys, which do not drift.
    """
    n = sum(map(len, groups))
    found = f"{many(n_kept, 'closure')} found" + (f", {n_rejected} rejected by the others" if n_rejected else "")
    found += f", {many(n_fixed, 'fixed point')} given" if n_fixed else ""
    if status is SlamStatus.UNCHANGED and bent is not None:
        return (
            f"odometry may bend {bent.path_length:.2g} m of path by {bent.bends_by:.2g} m, "
            f"too much if the field changes over {bent.length:.2g} m; if odometry is more accurate, say so with "
            "--odometry-sd"
        )
    if status is SlamStatus.UNCHANGED:
        what = "the field shows no revisited place" if n == 1 else "no closure connects the logs"
        advice = "pass some stretches twice, a few correlation lengths each"
        if is_rigid:
            advice = "survey a common region; magmatch register says of each pair what it lacks"
        return f"{what} ({found}); {advice}"
    guess = "" if guessed is None else (
        "; odometry is assumed to drift by {:g} m and {:g} degrees in 10 m: state yours with --odometry-sd"
    ).format(*guessed)  # fmt: skip
    if bent_logs:
        guess += (
            f"; {_some(bent_logs)}: corrected by more than the drift of odometry makes possible: a wrong closure or "
            "fixed point, or odometry worse than stated (--odometry-sd)"
        )
    if status is SlamStatus.CONNECTED:
        return f"{found}; {'the log is corrected' if n == 1 else f'all {n} are in one frame'}{guess}"
    alone = [group[0] for group in groups if len(group) == 1]
    words = f"{found}; {many(n, 'log')} in {len(groups)} frames of their own"
    words += f"; connected to no other: {_some(alone)}" if alone else ""
    return words + guess


def _some(names: Sequence[str]) -> str:
    return f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}"
