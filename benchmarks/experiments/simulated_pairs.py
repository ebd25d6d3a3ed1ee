"""Register simulated scenarios over many seeds; print success, median error and false accepts.

python benchmarks/experiments/simulated_pairs.py [--seeds 20] [--first 0] [--preset default paper]
"""

import argparse
import time

import numpy as np
from scipy.spatial.transform import RigidTransform

import magmatch as mm
from magmatch.geometry import transform_error
from magmatch.registration.config import PRESETS

SCENARIOS = ("office-z30", "office-x30", "office-random", "table", "table-robot", "corridor", "nowhere", "uniform")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--preset", nargs="+", choices=sorted(PRESETS), default=["default", "paper"])
    arguments = parser.parse_args()
    print("scenario       preset   accepted  median error of the best pose      95 %                 median time")
    for scenario in arguments.scenarios:
        for preset in arguments.preset:
            rows = np.array([run(scenario, preset, arguments.first + k) for k in range(arguments.seeds)])
            accepted, distance, angle, seconds = rows.T
            print(
                f"{scenario:14s} {preset:8s} {int(accepted.sum()):3d} of {len(rows):3d} "
                f"{1e3 * np.median(distance):9.2f} mm {np.median(angle):8.3f} deg "
                f"{1e3 * np.quantile(distance, 0.95):10.2f} mm {np.quantile(angle, 0.95):8.3f} deg "
                f"{np.median(seconds):7.2f} s",
                flush=True,
            )


def run(scenario: str, preset: str, seed: int) -> tuple[float, float, float, float]:
    """One pair: accepted, error of the best pose (m, deg; also where it was refused), seconds."""
    pair = mm.simulate(scenario, seed)
    start = time.perf_counter()
    result = mm.register(pair.base, pair.target, PRESETS[preset])
    seconds = time.perf_counter() - start
    best = result.T_base_target
    if best is None and result.alternatives:
        best = result.alternatives[0].T_base_target
    if best is None:
        return float(result.is_accepted), np.inf, 180.0, seconds
    distance, angle = transform_error(best, pair.T_base_target, pair.target.centroid)
    return float(result.is_accepted), distance, float(np.degrees(angle)), seconds


def best_pose(result: mm.RegistrationResult) -> RigidTransform | None:
    """The accepted pose, or the best candidate of a refusal."""
    if result.T_base_target is not None:
        return result.T_base_target
    return result.alternatives[0].T_base_target if result.alternatives else None


if __name__ == "__main__":
    main()
