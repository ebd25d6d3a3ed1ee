# SPDX-License-Identifier: BSD-3-Clause
"""Stretches of path as bases for windows: a small map of each, prepared for the search."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.distance import cdist

from magmatch.data.fingerprint import hash_survey
from magmatch.data.survey import Survey
from magmatch.field.config import FieldConfig
from magmatch.field.fit import fit_posterior
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.map import FieldMap
from magmatch.registration.index.walk_index import WalkIndex
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.registration.prepared.prepared_map import prepare
from magmatch.registration.search.pair_search import PairSearchConfig, PairTable, tabulate_pairs
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.pose_graph import PoseGraph
from magmatch.slam.graph.trajectories import corrected
from magmatch.slam.roughness import as_rough_as_here
from magmatch.slam.windows import Path
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Indices, Mask, Points

# Windows that a stretch is made for. It holds one more on either side, so that a window beside them lies inside.
TOGETHER = 2
# Posterior samples that give a base's spread.
N_DRAWS = 6
# Stretches kept in memory as bases, at one to three megabytes each.
MOST_BASES = 2048
# Bases that a worker keeps of those that it made: by their samples, at about six kilobytes each.
MOST_KEPT = 250_000
N = TypeVar("N", int, Indices)
A = TypeVar("A")
R = TypeVar("R")
# Applies a function to each of some tasks, which depend on themselves alone; results in the order of the tasks.
Run = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def stretch_of(node: N, first: N) -> N:
    """First node of the stretch that is made for a node's window, where the log's first node is given; or of each."""
    found: N = node - (node - first) % TOGETHER
    return found


@dataclass(frozen=True, eq=False, slots=True)
class Base:
    """A stretch of path prepared as a base for windows."""

    survey: Survey  # its samples
    node: Indices  # (n,): node whose window each sample lies in
    index: WalkIndex

    @property
    def volume(self) -> float:
        """Of the region that it knows, m^3."""
        return self.index.base.raster.volume

    def nodes_near(self, points: Points) -> Indices:
        """Nodes whose windows lie nearest to some points (k, 3) of the base's frame: (k,)."""
        return np.asarray(self.node[cdist(points, self.survey.positions).argmin(axis=1)])

    def are_near(self, points: Points, nodes: Indices) -> Mask:
        """Whether each point (k, 3) lies nearest to the window of one of some nodes."""
        return np.isin(self.nodes_near(points), nodes)


@dataclass(frozen=True, eq=False, slots=True)
class BaseTask:
    """All that the base of a stretch depends on."""

    survey: Survey  # as of a `Base`
    node: Indices
    numbers: Hyperparameters
    noise: PathNoise  # as known when the stretch was first asked for: it tells which pairs of points are listed
    length: float  # m: over which the field changes
    search: PairSearchConfig | None  # None: only poses that are given are weighed in it

    @property
    def name(self) -> str:
        """In words."""
        return f"the map of windows {self.node[0]} to {self.node[-1]}"

    @property
    def home(self) -> int:
        """What all tasks of a stretch have in common."""
        return int(self.node[0] + 1) // TOGETHER

    @property
    def key(self) -> tuple[str, bytes, str]:
        """What tells it from all others."""
        about = (self.numbers, self.noise, self.length, self.search)
        return hash_survey(self.survey), self.node.tobytes(), repr(about)


@single_threaded
def make_base(task: BaseTask) -> Base:
    """Map a stretch, and list its pairs of points if it is searched."""
    survey, length, noise = task.survey, task.length, task.noise
    T, settings = survey.principal_frame(), FieldConfig(leave_out_outliers=False)
    samples = survey.transformed(T.inv())
    field_map = FieldMap(survey, fit_posterior(samples, task.numbers, settings), T, settings, T, samples)
    prepared = prepare(field_map, N_DRAWS, np.random.default_rng(0))
    mean = field_map.posterior.without_factors()
    # Posterior samples are not asked for again.
    prepared = replace(
        prepared, field_map=replace(field_map, posterior=mean), posterior=mean, correlation_length=length, draws=list
    )
    if task.search is None:
        table = PairTable.empty(length)
    else:
        table = tabulate_pairs(prepared, length, noise.total_sd, task.search)
    return Base(survey, task.node, WalkIndex(prepared, length, noise, noise, table))


# Bases that this worker has made of tasks, and who changes them.
_kept: dict[tuple[str, bytes, str], Base] = {}
_keeping = Lock()


def base_of(given: Base | BaseTask, noise: PathNoise) -> Base:
    """A base with the noise of walks as it is known now; that of a task is made and kept."""
    return given if isinstance(given, Base) else with_noise(_made_of(given), noise)


def table_of(given: Base | BaseTask) -> PairTable:
    """Pairs of points of a base."""
    return _made_of(given).index.table


def volume_of(given: Base | BaseTask) -> float:
    """Of the region that a base knows, m^3."""
    return _made_of(given).volume


def with_noise(base: Base, noise: PathNoise) -> Base:
    """A base in which walks have other noise."""
    return replace(base, index=replace(base.index, noise=noise))


def _made_of(given: Base | BaseTask) -> Base:
    if isinstance(given, Base):
        return given
    if given.search is None:
        # It is asked for once.
        return make_base(given)
    key = given.key
    with _keeping:
        base = _kept.pop(key, None)
    base = base or make_base(given)
    with _keeping:
        # The one used last stands last.
        _kept[key] = base
        while len(_kept) > 1 and sum(len(one.node) for one in _kept.values()) > MOST_KEPT:
            del _kept[next(iter(_kept))]
    return base


@dataclass(eq=False, slots=True)
class BaseMaker:
    """Makes bases with given hyperparameters, which all logs of a place share, and keeps those used last."""

    numbers: Hyperparameters
    squared_gradient: float  # (T/m)^2: the mean along all paths that the numbers are of
    noise: PathNoise
    length: float  # m: over which the field changes
    config: SlamConfig
    run: Run | None = None  # lets workers map stretches and compare windows with them; None: this process does
    # Of each stretch that was asked for, by its node: what makes it, its pairs of points, and the base, if it is kept
    _tasks: dict[int, BaseTask] = field(default_factory=dict, init=False)
    _tables: dict[int, PairTable] = field(default_factory=dict, init=False)
    _made: dict[int, Base] = field(default_factory=dict, init=False)
    # Whole logs, by their first node: how many closures corrected them, and volumes
    _whole: dict[int, tuple[int, Base | BaseTask, float]] = field(default_factory=dict, init=False)

    def stretch(self, path: Path, node: int) -> Base:
        """The stretch made for a node's window and others, with one more on either side, odometry's frame."""
        return self.make([(path, node)])[0]

    def make(self, asked: Sequence[tuple[Path, int]]) -> list[Base]:
        """Stretches of some nodes; those that are not kept are made."""
        pairs = {stretch_of(node, path.first_node): (path, node) for path, node in asked}
        new = {node: self.task(*pair) for node, pair in pairs.items() if node not in self._made}
        for node, base in zip(new, side_by_side(make_base, new.values()), strict=True):
            self._made[node] = with_noise(base, self.noise)
        # Those used last stand last.
        found = {node: self._made.pop(node) for node in pairs}
        self._made.update(found)
        while len(self._made) > max(MOST_BASES, len(found)):
            del self._made[next(iter(self._made))]
        return [found[stretch_of(node, path.first_node)] for path, node in asked]

    def apply(self, function: Callable[[A], R], tasks: Sequence[A]) -> Iterable[R]:
        """Apply a function to each of some tasks, wherever the work is done.

        Not by threads: comparisons hold the interpreter so often that two at once take longer than in turn.
        """
        return (self.run or map)(function, tasks) if tasks else ()

    def given(self, asked: Sequence[tuple[Path, int]]) -> Sequence[Base | BaseTask]:
        """Stretches of some nodes, as a comparison takes them: made, or for workers to make."""
        return self.make(asked) if self.run is None else [self.task(path, node) for path, node in asked]

    def tables(self, asked: Sequence[tuple[Path, int]]) -> list[PairTable]:
        """Pairs of points of the stretches of some nodes."""
        nodes = [stretch_of(node, path.first_node) for path, node in asked]
        new = {node: pair for node, pair in zip(nodes, asked, strict=True) if node not in self._tables}
        given = self.given(list(new.values()))
        self._tables.update(zip(new, self.apply(table_of, given), strict=True))
        return [self._tables[node] for node in nodes]

    def task(self, path: Path, node: int) -> BaseTask:
        """What makes the stretch of a node, wherever it is made."""
        node = stretch_of(node, path.first_node)
        if node not in self._tasks:
            first, last = np.searchsorted(path.number, np.array([node - 1, node + TOGETHER + 1]) - path.first_node)
            rows = np.arange(first, last)
            self._tasks[node] = self._task_of(path.survey.subset(rows), path.nodes[path.number[rows]])
        return self._tasks[node]

    def whole(self, paths: Sequence[Path], graph: PoseGraph) -> tuple[list[Base | BaseTask], float]:
        """Whole logs, as the graph has them now, as a comparison takes them, and their volume together."""
        n = len(graph.closures)
        new = [path for path in paths if self._whole.get(path.first_node, (-1,))[0] != n]
        tasks = [self._task_of(corrected(path, graph), path.nodes[path.number]) for path in new]
        given: Sequence[Base | BaseTask] = side_by_side(make_base, tasks) if self.run is None else tasks
        for path, one, volume in zip(new, given, self.apply(volume_of, given), strict=True):
            self._whole[path.first_node] = n, one, volume
        found = [self._whole[path.first_node] for path in paths]
        return [one for _, one, _ in found], float(sum(volume for *_, volume in found))

    def joint(self, survey: Survey, node: Indices, n_averaged: float) -> BaseTask:
        """What makes one map of samples of several passes, each a mean of so many, for poses that are given.

        They measure what lies between them, of which a stretch has its prior alone.
        """
        numbers = replace(self.numbers, noise_sd=self.numbers.noise_sd / float(np.sqrt(n_averaged)))
        return BaseTask(survey, node, numbers, self.noise, self.length, None)

    def learn(self, noise: PathNoise) -> None:
        """Take other noise of walks, for bases that were made too."""
        self.noise = noise
        self._made = {node: with_noise(base, noise) for node, base in self._made.items()}

    def forget_whole(self) -> None:
        """Whole logs are not where they were."""
        self._whole.clear()

    def _task_of(self, survey: Survey, node: Indices) -> BaseTask:
        # Whatever else is known of them would be sent in vain.
        survey = replace(survey, times=None, orientations=None)
        numbers = as_rough_as_here(self.numbers, self.squared_gradient, survey, self.length)
        return BaseTask(survey, node, numbers, self.noise, self.length, self.config.search)
