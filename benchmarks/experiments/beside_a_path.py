"""What the map of a stretch says of the field beside its path, by the numbers of all paths and by its own.

    python benchmarks/experiments/beside_a_path.py --data DIR [--first 800] [--seeds 3] [--save NAME]

floor: lanes of `slam_lanes.py` through a phone's survey of a floor, with its field as the truth. corridor: simulated
walks, with their scene as the truth. Points lie 0.2 or 0.4 field lengths beside each stretch, where its map knows the
field and no other part of the stretch is nearer. Score: mean of ``z^2 / 2 + ln sd`` (sd in uT) of a component, z the
error over its stated sd; lower is better. Error over sd: the natural logarithm of the root of mean squares of each
stretch, its mean and its spread over stretches.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from slam_lanes import floor_field, lanes

import magmatch as mm
from magmatch.geometry import rotation_matrix
from magmatch.registration.index.map_index import WalkIndex
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scenarios import build_scene
from magmatch.simulation.scene import Streams
from magmatch.slam.config import SlamConfig
from magmatch.slam.places import begin
from magmatch.slam.search.submaps import TOGETHER, make_submap
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments

COLUMNS = ("place", "beside, field lengths", "stretches", "numbers", "score", "error over sd", "its spread")
BESIDE = (0.2, 0.4)
# Of the floor: lanes, m apart; and the noise of a component, T.
APART, NOISE = (1.2, 1.8, 3.0), 2e-8
# Samples of a stretch that are asked for, and the fewest points that make a figure.
EVERY, FEWEST = 8, 5
Field = Callable[[np.ndarray], np.ndarray]


def places(seed: int, data: Path) -> Iterator[tuple[str, mm.Survey, Field]]:
    """Walks without drift, and the field of their place."""
    for apart in APART:
        rng = np.random.default_rng([int(10 * apart), seed])
        path, field = lanes("floor", apart, seed, data, rng)
        walk = mm.Survey(path, field + NOISE * rng.standard_normal(field.shape))
        yield f"floor, lanes {apart} m apart", walk, lambda x: floor_field(data)(x[:, :2])
    config = SimulationConfig(pose_drift=0.0)
    scene = build_scene("corridor", config, Streams(seed))
    yield "corridor", mm.simulate("corridor", seed, config).base, scene.base_field


def beside(path: np.ndarray, apart: float) -> np.ndarray:
    """Points on both sides of a path, of which no part of it is nearer."""
    along = np.gradient(path, axis=0)[::EVERY]
    walks = np.linalg.norm(along, axis=1) > 0
    aside = np.cross([0, 0, 1.0], along[walks] / np.linalg.norm(along[walks], axis=1)[:, None])
    points = np.concatenate([path[::EVERY][walks] + side * apart * aside for side in (1, -1)])
    return points[cKDTree(path).query(points)[0] > 0.8 * apart]


def figures(index: WalkIndex, points: np.ndarray, truth: Field) -> tuple[float, float] | None:
    """Score, and logarithm of error over sd, of a stretch's map at some points."""
    base = index.base
    at = base.T_map_model.inv().apply(points)
    _, sd, _, is_known = base.raster.lookup(at)
    if is_known.sum() < FEWEST:
        return None
    points, at, sd = points[is_known], at[is_known], sd[is_known]
    predicted = base.posterior.evaluate(at).field @ rotation_matrix(base.T_map_model).T
    error2 = ((predicted - truth(points)) ** 2).mean(axis=1)
    return float((error2 / sd**2 / 2 + np.log(sd / 1e-6)).mean()), float(0.5 * np.log(error2.mean() / (sd**2).mean()))


def main() -> None:
    asked = arguments(__doc__, data=Path, first=800, seeds=3, save=saver)
    found: dict[tuple[str, float, str], list[tuple[float, float]]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        for name, walk, truth in places(seed, asked.data):
            session = begin([walk], SlamConfig(is_planar=True))
            (path,), maker = session.paths, session.maker
            assert maker is not None
            for node in range(0, len(path.windows), TOGETHER):
                survey, nodes, own, noise, length, _ = maker.piece(path, node).arguments
                for what, numbers in (("of all paths", maker.hyperparameters), ("its own", own)):
                    index = make_submap(survey, nodes, numbers, noise, length, False).index
                    for apart in BESIDE:
                        some = beside(survey.positions, apart * maker.length)
                        if len(some) and (one := figures(index, some, truth)) is not None:
                            found.setdefault((name, apart, what), []).append(one)
    rows = []
    for (name, apart, what), some in sorted(found.items()):
        (score, ratio), spread = np.mean(some, axis=0), np.std(some, axis=0)[1]
        rows.append([name, apart, len(some), what, f"{score:.2f}", f"{ratio:.2f}", f"{spread:.2f}"])
    show(COLUMNS, rows, asked.save)


if __name__ == "__main__":
    main()
