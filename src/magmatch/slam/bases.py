# SPDX-License-Identifier: BSD-3-Clause
"""Stretches of path as bases for windows: a small map of each, prepared for the search."""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.distance import cdist

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
from magmatch.slam.windows import Path
from magmatch.threads import side_by_side, single_threaded
from magmatch.typing import Indices, Mask, Points

# Windows that a stretch is made for. It holds one more on either side, so that a window beside them lies inside.
TOGETHER = 2
# Posterior samples that give a base's spread.
N_DRAWS = 6
# Stretches kept in memory as bases, at about a megabyte each.
MOST_BASES = 2048
A = TypeVar("A")
T = TypeVar("T")
N = TypeVar("N", int, Indices)
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
    noise: (
        PathNoise  # as it was known when the stretch was first asked for: it tells which pairs of points are listed
    )
    length: float  # m: over which the field changes
    search: PairSearchConfig

    @property
    def name(self) -> str:
        """In words."""
        return f"the map of windows {self.node[0]} to {self.node[-1]}"

    @property
    def home(self) -> int:
        """What all tasks of a stretch have in common, and neighbouring stretches have not."""
        return int(self.node[0] + 1) // TOGETHER

    @property
    def key(self) -> bytes:
        """What tells it from all others."""
        digest = hashlib.sha256(repr((self.numbers, self.noise, self.length, self.search)).encode())
        for array in (self.survey.positions, self.survey.field, self.node):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.digest()


@single_threaded
def make_base(task: BaseTask) -> Base:
    """Map a stretch and list its pairs of points."""
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
    table = tabulate_pairs(prepared, length, noise.total_sd, task.search)
    return Base(survey, task.node, WalkIndex(prepared, length, noise, noise, table))


# Bases that this worker has made of tasks, at about three megabytes each.
MOST_KEPT = 512
_kept: dict[bytes, Base] = {}


def base_of(given: Base | BaseTask, noise: PathNoise) -> Base:
    """A base with the noise of walks as it is known now; that of a task is made and kept."""
    if isinstance(given, Base):
        return given
    key = given.key
    base = _kept[key] = _kept.pop(key) if key in _kept else make_base(given)
    if len(_kept) > MOST_KEPT:
        del _kept[next(iter(_kept))]
    return with_noise(base, noise)


def with_noise(base: Base, noise: PathNoise) -> Base:
    """A base in which walks have other noise."""
    return replace(base, index=replace(base.index, noise=noise))


def table_of(task: BaseTask) -> PairTable:
    """Pairs of points of a stretch."""
    return base_of(task, task.noise).index.table


def volume_of(given: Base | BaseTask) -> float:
    """Of the region that a base knows, m^3."""
    return (given if isinstance(given, Base) else base_of(given, given.noise)).volume


@dataclass(eq=False, slots=True)
class BaseMaker:
    """Makes bases with given hyperparameters, which all logs of a place share, and keeps those used last."""

    numbers: Hyperparameters
    noise: PathNoise
    length: float  # m: over which the field changes
    config: SlamConfig
    run: Run | None = None  # lets workers map stretches and compare windows with them; None: this process does
    # By node, and the pairs of points of each that was ever made; whole logs with how many closures corrected them.
    _made: dict[int, Base] = field(default_factory=dict, init=False)
    _tables: dict[int, PairTable] = field(default_factory=dict, init=False)
    _tasks: dict[int, BaseTask] = field(default_factory=dict, init=False)
    _whole: dict[int, tuple[int, Base | BaseTask]] = field(default_factory=dict, init=False)

    def stretch(self, path: Path, node: int) -> Base:
        """The stretch made for a node's window and others, with one more on either side, odometry's frame."""
        self.make([(path, node)])
        node = stretch_of(node, path.first_node)
        # The one used last stands last.
        base = self._made[node] = self._made.pop(node)
        return base

    def make(self, asked: Iterable[tuple[Path, int]]) -> None:
        """Make the stretches of some nodes that are not made yet."""
        tasks = {stretch_of(node, path.first_node): self.task(path, node) for path, node in asked}
        new = {node: task for node, task in tasks.items() if node not in self._made}
        for node, base in zip(new, side_by_side(make_base, new.values()), strict=True):
            self._made[node], self._tables[node] = with_noise(base, self.noise), base.index.table
        while len(self._made) > max(MOST_BASES, len(tasks)):
            del self._made[next(iter(self._made))]

    def apply(self, function: Callable[[A], T], tasks: Sequence[A]) -> Iterable[T]:
        """Apply a function to each of some tasks, wherever the work is done."""
        return (self.run or side_by_side)(function, tasks)

    def given(self, asked: Sequence[tuple[Path, int]]) -> Sequence[Base | BaseTask]:
        """Stretches of some nodes, as a comparison takes them: made, or for workers to make."""
        if self.run is not None:
            return [self.task(path, node) for path, node in asked]
        self.make(asked)
        return [self.stretch(path, node) for path, node in asked]

    def tables(self, asked: Sequence[tuple[Path, int]]) -> list[PairTable]:
        """Pairs of points of the stretches of some nodes, no two of one stretch."""
        nodes = [stretch_of(node, path.first_node) for path, node in asked]
        new = {node: pair for node, pair in zip(nodes, asked, strict=True) if node not in self._tables}
        if self.run is None:
            self.make(new.values())
        else:
            self._tables.update(
                zip(new, self.run(table_of, [self.task(*pair) for pair in new.values()]), strict=True)
            )
        return [self._tables[node] for node in nodes]

    def task(self, path: Path, node: int) -> BaseTask:
        """What makes the stretch of a node, wherever it is made."""
        node = stretch_of(node, path.first_node)
        if node not in self._tasks:
            first, last = np.searchsorted(path.number, np.array([node - 1, node + TOGETHER + 1]) - path.first_node)
            rows = np.arange(first, last)
            self._tasks[node] = self._task_of(path.survey.subset(rows), path.nodes[path.number[rows]])
        return self._tasks[node]

    def whole(self, path: Path, graph: PoseGraph) -> Base | BaseTask:
        """A whole log, as the graph has it now: made, or for workers to make."""
        n, base = self._whole.get(path.first_node, (-1, None))
        if base is None or n != len(graph.closures):
            task = self._task_of(corrected(path, graph), path.nodes[path.number])
            base = make_base(task) if self.run is None else task
            self._whole[path.first_node] = len(graph.closures), base
        return base

    def learn(self, noise: PathNoise) -> None:
        """Take other noise of walks, for bases that were made too."""
        self.noise = noise
        self._made = {node: with_noise(base, noise) for node, base in self._made.items()}
        self._whole.clear()

    def _task_of(self, survey: Survey, node: Indices) -> BaseTask:
        return BaseTask(survey, node, self.numbers, self.noise, self.length, self.config.search)
