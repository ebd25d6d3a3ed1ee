"""The published corridor with frames known to be upright, against an oracle that knows what corresponds.

    python benchmarks/experiments/upright_corridor.py [--seeds 20] [--first 0] [--save NAME]

Both walks drift as dead reckoning does. The oracle is told which places of the two walks are the same, and how far
apart their samples truly are; it fits one transform to the positions as recorded, by least squares: any rotation, or
one about the vertical. Tilt is how far the vertical is off; its standard deviation is as stated. Within two: share of
answers whose tilt is at most twice that. ``--gravity-aligned`` takes the vertical to be known to half a degree; the
last row is told that it is exact, as the upright oracle is. Maps are made once for all.
"""

import logging

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.geometry import transform_error
from magmatch.registration.config import RegistrationConfig
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import SimulatedPair
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments

COLUMNS = (
    "what", "n", "accepted", "rms, mm", "rms rotation, deg", "over the oracle's", "rms tilt, deg", "within two sd",
)  # fmt: skip


def oracle(seed: int, pair: SimulatedPair, *, is_upright: bool) -> RigidTransform:
    """Least squares over true correspondences of positions as recorded."""
    true = mm.simulate("corridor", seed, SimulationConfig(pose_drift=0.0))
    there = pair.T_base_target.apply(true.target.positions)
    rows = cKDTree(true.base.positions).query(there)[1]
    p = pair.target.positions
    q = pair.base.positions[rows] + there - true.base.positions[rows]
    a, b = p - p.mean(axis=0), q - q.mean(axis=0)
    if is_upright:
        a, b = a * [1, 1, 0], b * [1, 1, 0]
        a, b = np.concatenate([a, [[0, 0, 1e6]]]), np.concatenate([b, [[0, 0, 1e6]]])
    R = Rotation.align_vectors(b, a)[0]
    return RigidTransform.from_components(q.mean(axis=0) - R.apply(p.mean(axis=0)), R)


def main() -> None:
    asked = arguments(__doc__, seeds=20, first=0, save=saver)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    priors: dict[str, dict[str, object]] = {
        "any pose": {},
        "`--gravity-aligned`": {"is_gravity_aligned": True},
        "`--gravity-aligned --gravity-sd 0.01`": {"is_gravity_aligned": True, "gravity_sd": np.radians(0.01)},
    }
    names = ("oracle, any rotation", "oracle, upright", *priors)
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in names}
    for seed in range(asked.first, asked.first + asked.seeds):
        pair = mm.simulate("corridor", seed)
        for name, is_upright in zip(names[:2], (False, True), strict=True):
            found[name].append((1.0, *errors(oracle(seed, pair, is_upright=is_upright), pair), np.nan))
        base, target = mm.build_map(pair.base, SPLINE), mm.build_map(pair.target, SPLINE)
        for name, prior in priors.items():
            result = mm.register(base, target, RegistrationConfig.model_validate({"prior": prior}))
            assert result.best_pose is not None
            m, turn, tilt = errors(result.best_pose, pair)
            # About the target's x and y, which the target's axes lie along where both frames are upright.
            C = np.full((6, 6), np.nan) if result.covariance is None else result.covariance
            sd = float(np.degrees(np.sqrt(np.trace(C[:2, :2]))))
            found[name].append((float(result.is_accepted), m, turn, tilt, tilt / sd))
    floors = {is_upright: rms(found[names[is_upright]])[1] for is_upright in (False, True)}
    lines = []
    for name, rows in found.items():
        m, turn, tilt = rms(rows)
        within = [row[4] <= 2 for row in rows if np.isfinite(row[4])]
        lines.append([
            name, str(len(rows)), "" if name.startswith("oracle") else str(int(sum(row[0] for row in rows))),
            f"{1e3 * m:.0f}", f"{turn:.2f}", f"{turn / floors['upright' in name or 'gravity' in name]:.2f}",
            f"{tilt:.3f}", f"{sum(within)} of {len(within)}" if within else "",
        ])  # fmt: skip
    show(COLUMNS, lines, asked.save)


def errors(T: RigidTransform, pair: SimulatedPair) -> tuple[float, float, float]:
    """How far off a pose is: at the target's centre (m), its rotation and its vertical (deg)."""
    distance, angle = transform_error(T, pair.T_base_target, pair.target.centroid)
    tilt = np.arccos(np.clip((T * pair.T_base_target.inv()).rotation.as_matrix()[2, 2], -1, 1))
    return distance, float(np.degrees(angle)), float(np.degrees(tilt))


def rms(rows: list[tuple[float, ...]]) -> np.ndarray:
    """Root mean squares of distance, rotation and tilt."""
    return np.sqrt((np.array(rows)[:, 1:4] ** 2).mean(axis=0))


if __name__ == "__main__":
    main()
