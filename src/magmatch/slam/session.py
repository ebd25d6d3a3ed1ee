# SPDX-License-Identifier: BSD-3-Clause
"""The session of slam and merge: logs and their graph."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np
from scipy.spatial.transform import RigidTransform

from magmatch._version import __version__
from magmatch.arguments import expect_kind, whole_number_of
from magmatch.brief import brief
from magmatch.data.checks import require_walk
from magmatch.data.fingerprint import describe_input
from magmatch.data.geodesy import Origin
from magmatch.data.survey import Survey
from magmatch.data.survey_columns import frame_about
from magmatch.errors import SurveyError
from magmatch.field.build import build_map
from magmatch.field.config import SPLINE, FieldConfig
from magmatch.field.map import FieldMap
from magmatch.progress import Progress, followed
from magmatch.registration.clock import Clock
from magmatch.runner import Runner, Workers
from magmatch.settings import Settings
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, points_passed
from magmatch.slam.graph.odometry import covariance_of_end
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.solve import warn_of_a_wrong_point
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.live import LiveLog
from magmatch.slam.loop_search import KINDS
from magmatch.slam.places import NO_BIAS, Bias, Places, settled
from magmatch.slam.result import LogResult, SlamResult, SlamStatus
from magmatch.slam.slam import correct, correct_more
from magmatch.slam.statement import explain, place_and_turn, state_anchors, state_closures, state_odometry
from magmatch.slam.turned_fields import warn_of_turned_fields
from magmatch.slam.windows import Path
from magmatch.typing import Indices, Vector3


@dataclass(eq=False)
class Session:
    """Logs, their pose graph, and what follows from it.

    Attributes
    ----------
    config : Settings
        Settings of slam (by default) or of merge.
    given : list of Survey
        The logs as given.
    places : Places
        Each log without its sensor's bias, divided into windows, and the graph.
    seconds : dict
        Per stage and total.
    seed : int

    Examples
    --------
    ``session = mm.Session()``; for each sample ``session.add(t, T_odom_body, field)`` and ``session.pose()``;
    ``session.finish()`` at the end.
    """

    config: Settings | None = None
    given: list[Survey] = field(default_factory=list)
    places: Places | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    seed: int = 0
    _live: LiveLog | None = field(default=None, init=False, repr=False)
    _maps: dict[int, FieldMap] = field(default_factory=dict, init=False, repr=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        self.config = self.config or SlamConfig()
        expect_kind(self.config, "config", (Settings,))

    def add_logs(
        self,
        logs: Sequence[Survey],
        anchors: Sequence[Anchor] | str | FilePath = (),
        *,
        waypoints: bool = True,
        run: Workers | None = None,
        progress: Progress | None = None,
        keep: str | FilePath | None = None,
    ) -> None:
        """Add finished logs: the first ones all at once, later ones without redoing the earlier ones.

        Parameters
        ----------
        logs : sequence of Survey
            Each with positions from odometry, in its own frame.
        anchors, waypoints, run, progress, keep
            See `slam`.
        """
        config, clock, earlier = self._of_slam(), Clock(), self.places
        if self._live is not None:
            msg = "a live log is open; finish() it before adding others"
            raise ValueError(msg)
        for survey in logs:
            require_walk(survey)
        given = [*self.given, *logs]
        require_distinct(given)
        names, n_known = unique_stems([survey.name for survey in given]), len(self.given)
        before = earlier.anchors if earlier else []
        fixed, origin = points_passed(anchors, given, names, n_known, before, config.origin, waypoints=waypoints)
        config = config.model_copy(update={"origin": origin})
        with followed(progress), Runner(run, keep, KINDS) as runner:
            if earlier is None or earlier.maker is None:
                config = settled(given, config)
                places = correct(given, config, [*before, *fixed], runner, clock)
            else:
                places = correct_more(earlier, logs, fixed, runner, clock)
        places.stated = places.stated.model_copy(update={"origin": origin})
        self.config = config.model_copy(update={"is_planar": places.stated.is_planar})
        self.given, self.places = given, places
        self.seconds = dict(Counter(self.seconds) + Counter(clock.seconds()))
        self._changed()
        warn_of_a_wrong_point(places.graph, [anchor.source for anchor, _ in places.anchors])
        if places.maker is not None and config.is_gravity_aligned:
            warn_of_turned_fields(self.trajectories, self.components, places.maker.length, n_known)

    def add_log(self, survey: Survey) -> None:
        """Add one more log, without redoing the earlier ones."""
        self.add_logs([survey])

    def add(self, t: float, T_odom_body: RigidTransform, field: Vector3) -> bool:
        """Add one sample of a live log.

        Parameters
        ----------
        t : float, s
            Later than that of the previous sample.
        T_odom_body : RigidTransform
            Odometry's pose of the body that carries the sensor.
        field : (3,) array, T
            In the body's axes.

        Returns
        -------
        bool
            Whether a window was completed, and with it the estimates of all poses changed.

        Raises
        ------
        ValueError
            The time does not increase, or a number is not finite; the sample is not added.
        """
        if self._live is None and self.places is not None and self.places.maker is None:
            msg = "the earlier logs' field is constant, so nothing can be compared with it; begin a new Session"
            raise ValueError(msg)
        # A first sample that is refused begins no log.
        live = self._live or LiveLog(self._of_slam(), self.places)
        is_changed = live.add(t, T_odom_body, field)
        self._live = live
        if is_changed:
            self._changed()
        return is_changed

    def pose(self) -> RigidTransform:
        """Corrected pose of the body after the last sample, in the frame of its component."""
        if self._live is None:
            msg = "expected a live log, got none; add(t, T_odom_body, field) starts one"
            raise ValueError(msg)
        return self._live.pose()

    def finish(self, name: str = "live", *, progress: Progress | None = None) -> None:
        """End the live log, and replace its result by that of the whole log.

        If the session has no other logs, this is the result of `slam` for its samples, whose fields were turned into
        odometry's axes, which rounds them; otherwise that of `add_log`.
        """
        if self._live is None:
            return
        live, self._live = self._live, None
        self._changed()
        try:
            self.add_logs([replace(live.survey(), name=name)], progress=progress)
        except BaseException:
            # What was walked is not lost where this is interrupted: it can be finished again.
            self._live = live
            self._changed()
            raise

    def _of_slam(self) -> SlamConfig:
        if not isinstance(self.config, SlamConfig):
            msg = "a session of merge cannot take logs that drift; use Session() or slam"
            raise TypeError(msg)
        return self.config

    def _changed(self) -> None:
        """Forget what followed from the graph as it was."""
        for name in ("names", "logs", "trajectories", "components"):
            self.__dict__.pop(name, None)
        self._maps.clear()

    @property
    def _now(self) -> Places:
        """The present state, with the log that is being walked."""
        live = None if self._live is None else self._live.places
        places = live or self.places
        if places is None:
            msg = "the session has no log yet; add a log, or samples until a window is complete"
            raise ValueError(msg)
        return places

    @property
    def is_rigid(self) -> bool:
        """Whether each log is one node: merged, not corrected."""
        return self.places is not None and self.places.is_rigid

    @property
    def paths(self) -> list[Path]:
        """Each log divided into windows, without its sensor's bias."""
        return self._now.paths

    @property
    def graph(self) -> PoseGraph:
        """The pose graph."""
        return self._now.graph

    @cached_property
    def logs(self) -> list[Survey]:
        """The logs as given; of a live one, the completed windows."""
        return [*self.given, *(path.survey for path in self.paths[len(self.given) :])]

    @cached_property
    def names(self) -> list[str]:
        """Stems of the logs' names, made unique."""
        return unique_stems([survey.name for survey in self.logs])

    @cached_property
    def trajectories(self) -> list[Survey]:
        """Each log with corrected positions, orientations and field, in the frame of its component."""
        graph, origin, found = self.graph, self._now.stated.origin, []
        for path, component in zip(self.paths, self.component_of, strict=True):
            frame = f"map_{component + 1}" if component else "map"
            if origin is not None and graph.is_fixed(path.first_node):
                frame = frame_about(Origin(*origin))  # as readers of degrees name it
            found.append(replace(corrected(path, graph), frame=frame, is_dead_reckoned=False))
        return found

    @cached_property
    def components(self) -> list[list[int]]:
        """Logs that share a frame, the component with the longest path first."""
        frames = self.graph.frames()
        groups = [np.flatnonzero(frames == frame).tolist() for frame in np.unique(frames)]
        return sorted(groups, key=lambda logs: -sum(self.paths[k].walked[-1] for k in logs))

    @property
    def component_of(self) -> list[int]:
        """Component of each log."""
        return [next(k for k, c in enumerate(self.components) if log in c) for log in range(len(self.paths))]

    def map(self, component: int = 0, config: FieldConfig | None = None) -> FieldMap:
        """One map of all logs of a component; with the default settings it is computed once."""
        whole_number_of(component, "component", most=len(self.components) - 1)
        if config is None and component in self._maps:
            return self._maps[component]
        made = build_map([self.trajectories[k] for k in self.components[component]], config or SPLINE)
        if config is None:
            self._maps[component] = made
        return made

    @property
    def map_biases(self) -> list[Bias]:
        """What each log's readings still have of its sensor's bias, and sd (T), as the maps made so far know it."""
        found = [NO_BIAS] * len(self.paths)
        for component, made in self._maps.items():
            logs = self.components[component]
            if made.biases is not None and len(made.surveys) == len(logs):
                for k, bias, sd in zip(logs, made.biases.bias, made.biases.sd, strict=True):
                    found[k] = bias, sd
        return found

    def result(self) -> SlamResult:
        """The result as a document; once a map is made it states the biases that were solved with it."""
        places, names = self._now, self.names
        logs = tuple(self._state_log(k) for k in range(len(self.paths)))
        if not any(log.n_closures or log.is_fixed for log in logs):
            status = SlamStatus.UNCHANGED
        else:
            status = SlamStatus.CONNECTED if len(self.components) == 1 else SlamStatus.PARTLY_CONNECTED
        live = [] if self._live is None or len(self.paths) == len(self.given) else [self._live.survey()]
        return SlamResult(
            status,
            explain(status, places, self.components, names),
            logs,
            state_closures(places, names),
            state_anchors(places, names),
            state_odometry(places, self.map_biases, [*self.given, *live], names),
            dict(self.seconds),
            {} if self.config is None else self.config.model_dump(mode="json"),
            __version__,
            self.seed,
            tuple(describe_input(s) for s in self.logs),
        )

    def _state_log(self, log: int) -> LogResult:
        path, after = self.paths[log], self.trajectories[log]
        component = self.component_of[log]
        T = self.T_map_log(log)
        moved = after.positions - T.apply(path.survey.positions)
        nodes = set(path.nodes.tolist())
        is_fixed = self.graph.is_fixed(path.first_node)
        is_placed = len(self.paths) == 1 or len(self.components[component]) > 1 or is_fixed
        C = self.graph.covariances(path.nodes[-1:])[0]
        if not self.is_rigid:
            C = covariance_of_end(path, C, self.graph.config, from_start=not is_fixed)
        return LogResult(
            self.names[log],
            component,
            T if is_placed else None,
            float(path.walked[-1]),
            sum(c.is_kept and bool({c.first, c.second} & nodes) for c in self.graph.closures),
            float(np.sqrt((moved**2).sum(axis=1).mean())),
            place_and_turn(C),
            is_fixed,
        )

    def T_map_log(self, log: int) -> RigidTransform:
        """Corrected first pose of a log times the inverse of its odometry's."""
        path = self.paths[log]
        return self.graph.pose(path.first_node) * RigidTransform.from_translation(-path.windows[0].center)

    def standard_deviations(self, nodes: Indices) -> list[tuple[float, float]]:
        """Standard deviations of nodes (m, rad) against their component's first, or in the fixed points' frame."""
        return [place_and_turn(C) for C in self.graph.covariances(nodes)]

    def covariances_of_place(self, nodes: Indices) -> np.ndarray:
        """Covariance of nodes' places in the axes of their component's frame, as `standard_deviations`: (n, 3, 3)."""
        R = self.graph.R[nodes]
        return np.asarray(R @ self.graph.covariances(nodes)[:, 3:, 3:] @ np.swapaxes(R, 1, 2))


def require_distinct(surveys: Sequence[Survey]) -> None:
    """Refuse samples that are given twice: they would agree with themselves."""
    known: dict[str, str] = {}
    for survey in surveys:
        sha, name = describe_input(survey)["sha256"], survey.name or "a survey"
        if sha in known:
            msg = f"{name}: holds the same samples as {known[sha]}, expected each only once"
            raise SurveyError(msg)
        known[sha] = name


def unique_stems(files: Sequence[str]) -> list[str]:
    """Stems of files' names, made unique."""
    names: list[str] = []
    for file in files:
        stem = FilePath(file).stem or "log"
        others = (f"{stem}_{k}" for k in range(2, len(files) + 2))
        names.append(next(name for name in (stem, *others) if name.lower() not in map(str.lower, names)))
    return names
