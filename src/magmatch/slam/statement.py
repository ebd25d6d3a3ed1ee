# SPDX-License-Identifier: BSD-3-Clause
"""The graph's state in the terms of the result: closures of bodies, estimated odometry, and words."""

from collections.abc import Iterator, Sequence

import numpy as np

from magmatch.data.survey import Survey
from magmatch.geometry import adjoint
from magmatch.number_text import many
from magmatch.preparation.odometry.drift import OdometryConfig
from magmatch.slam.graph.learned_drift import teaches_drift
from magmatch.slam.graph.solve import MOST_BENT, strains
from magmatch.slam.places import Bias, Places
from magmatch.slam.result import AnchorResult, ClosureResult, DriftResult, LogOdometry, Recalibration, SlamStatus
from magmatch.slam.sensor_bias import recalibrations_of
from magmatch.typing import Covariance6


def state_closures(places: Places, names: Sequence[str]) -> tuple[ClosureResult, ...]:
    """Closures between nodes as closures between bodies; between rigid surveys, as between their frames."""
    found = []
    for c in places.graph.closures:
        (T_a, t_a, walked_a), (T_b, t_b, walked_b) = places.body_at(c.first), places.body_at(c.second)
        name_a, name_b = (names[places.graph.log[node]] for node in (c.first, c.second))
        T, M = T_a.inv() * c.T_first_second * T_b, adjoint(T_b.inv())
        probability, weight = float(1 / (1 + np.exp(-c.log_odds))), float(c.weight) if c.is_kept else 0.0
        C = M @ c.covariance @ M.T
        found.append(ClosureResult(name_a, t_a, name_b, t_b, T, C, probability, weight, walked_a, walked_b))
    return tuple(found)


def state_anchors(places: Places, names: Sequence[str]) -> tuple[AnchorResult, ...]:
    """Fixed points, each with the residuals of its log there."""
    graph, found = places.graph, []
    for (a, of), off, without, C in zip(places.anchors, graph.off_fixed(), *graph.off_fixed_without(), strict=True):
        sd_without = float(np.sqrt(np.trace(C) / 3))
        stated = names[of], a.t, a.position.tolist(), a.sd
        found.append(AnchorResult(*stated, off.tolist(), without.tolist(), sd_without))
    return tuple(found)


def state_odometry(
    places: Places, in_maps: Sequence[Bias], logs: Sequence[Survey], names: Sequence[str]
) -> DriftResult:
    """The drift of the odometry, and each log's constant errors; rigid surveys have none.

    A bias is what the graph began with and the map's part, which knows it better.
    """
    if places.is_rigid:
        return DriftResult()
    graph, each = places.graph, {}
    for name, survey, (scale, rate), (first, first_sd), (more, sd) in zip(
        names, logs, graph.lasting.tolist(), places.biases, in_maps, strict=True
    ):
        each[name] = LogOdometry(
            scale=float(np.expm1(scale)),
            turn_rate=rate,
            bias=(first + more).tolist(),
            bias_sd=(sd if sd.any() else first_sd).tolist(),
            recalibrations=_state_recalibrations(survey),
        )
    return DriftResult(sd=graph.config.odometry.sd, logs=each)


def _state_recalibrations(survey: Survey) -> list[Recalibration]:
    if survey.times is None:
        return []
    found = recalibrations_of(survey)
    times, steps = survey.times[found.rows].tolist(), found.steps.tolist()
    return [Recalibration(t=t, step=step) for t, step in zip(times, steps, strict=True)]


def place_and_turn(C: Covariance6) -> tuple[float, float]:
    """Standard deviations of a pose, m and rad, of all directions together."""
    place, turn = (float(np.sqrt(max(np.trace(block), 0.0))) for block in (C[3:, 3:], C[:3, :3]))
    return place, turn


def explain(status: SlamStatus, places: Places, components: Sequence[Sequence[int]], names: Sequence[str]) -> str:
    """Say in words how the logs are connected, what may be wrong with that, or how they could be."""
    closures, n = places.graph.closures, len(names)
    n_kept = sum(c.is_kept for c in closures)
    found = f"{many(n_kept, 'closure')} found"
    found += f", {len(closures) - n_kept} rejected by the others" if n_kept < len(closures) else ""
    found += f", {many(len(places.anchors), 'fixed point')} given" if places.anchors else ""
    if status is SlamStatus.UNCHANGED:
        return _why_unchanged(places, found)
    if status is SlamStatus.CONNECTED:
        frames = ["the log is corrected" if n == 1 else f"all {n} are in one frame"]
    else:
        frames = [f"{many(n, 'log')} in {len(components)} frames of their own"]
        if alone := [names[group[0]] for group in components if len(group) == 1]:
            frames.append(f"connected to no other: {_some(alone)}")
        frames += _if_tilted(places)
    return "; ".join([found, *frames, *_doubts(places, names)])


def _why_unchanged(places: Places, found: str) -> str:
    """What is missing for closures: odometry that keeps a window's shape, or places that are passed twice."""
    windows = [] if places.maker is None else [w for path in places.paths for w in path.windows]
    if windows and not any(w.keeps_shape for w in windows):
        bent = windows[0]
        return (
            f"odometry may bend {bent.path_length:.2g} m of path by {bent.bends_by:.2g} m, "
            f"too much if the field changes over {bent.length:.2g} m; if odometry is more accurate, say so with "
            "--odometry-sd"
        )
    what = "the field shows no revisited place" if len(places.paths) == 1 else "no closure connects the logs"
    advice = "pass some stretches twice, a few correlation lengths each"
    if places.is_rigid:
        advice = "survey a common region; magmatch register says of each pair what it lacks"
    return "; ".join([f"{what} ({found})", advice, *_if_tilted(places)])


def _if_tilted(places: Places) -> list[str]:
    """What would keep logs apart whose frames are tilted, unless z is not taken for up, or poses show that it is."""
    is_up = places.stated.is_gravity_aligned and not places.stated.is_planar
    return ["if z is not up in all logs, say --no-gravity"] if is_up and len(places.paths) > 1 else []


def _doubts(places: Places, names: Sequence[str]) -> Iterator[str]:
    """What may be wrong: a drift neither stated nor learned, and logs corrected by more than it makes possible."""
    stated, surveys = places.stated, [path.survey for path in places.paths]
    is_stated = stated.odometry.sd != OdometryConfig().sd or all(
        stated.sd_stated(s.name) is not None for s in surveys
    )
    if not (places.is_rigid or is_stated or teaches_drift(places.graph)):
        place, turn = stated.odometry.sd
        said = f"{place:g} m and {turn:g} degrees in 10 m"
        yield f"odometry is assumed to drift by {said}: state yours with --odometry-sd"
    if bent := [names[k] for k in np.flatnonzero(strains(places.graph) > MOST_BENT).tolist()]:
        yield (
            f"{_some(bent)}: corrected by more than the drift of odometry makes possible: a wrong closure or "
            "fixed point, or odometry worse than stated (--odometry-sd)"
        )


def _some(names: list[str]) -> str:
    return f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}"
