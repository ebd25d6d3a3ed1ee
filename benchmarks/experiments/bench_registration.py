"""How long a registration takes as surveys and places grow, and whether the answer follows every frame.

    python benchmarks/experiments/bench_registration.py [growth] [frames] [--frames 1000] [--seed 30]

``growth``: processor time of each stage (two maps, preparation, search, refinement) for more samples in one room and
for larger rooms at one density. ``frames``: two surveys of a room, each in many random frames: how far the answer
strays from the one in their own frames, where the maps are carried along and where each survey is mapped anew, and
whether swapping base and target inverts it, in its standard deviations. One thread.
"""

import numpy as np

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.geometry import random_transform
from magmatch.simulation.config import SimulationConfig
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, timed

SAMPLES = (750, 1500, 3000, 6000, 12_000, 24_000)
SIDES = (2.0, 2.83, 4.0, 5.66, 8.0, 11.3, 16.0)
GROWTH = ("samples", "floor, m^2", "two maps, s", "registration with maps kept, s", "status")
FRAMES = ("what", "accepted", "strays by at most")
DENSITY = 333.0  # samples per m^2 of floor: 3,000 in 9 m^2


def grow(seed: int) -> list[list[str]]:
    rows = []
    sizes = [(n, 3.0) for n in SAMPLES] + [(round(DENSITY * side**2), side) for side in SIDES]
    for n, side in sizes:
        config = SimulationConfig(n_samples=n, room_size=(side, side, 0.8))
        pair = mm.simulate("office-random", seed, config)
        maps, _, mapping = timed(lambda pair=pair: [mm.build_map(s, SPLINE) for s in (pair.base, pair.target)])
        mm.register(*maps)
        result, _, matching = timed(mm.register, *maps)
        rows.append([f"{n:,}", f"{side**2:.0f}", f"{mapping:.2f}", f"{matching:.2f}", result.status.value])
        print(*rows[-1], flush=True)
    return rows


def turn(seed: int, n_frames: int) -> list[list[str]]:
    """Largest deviations over random frames, in standard deviations and in m and rad."""
    rng = np.random.default_rng(seed)
    pair = mm.simulate("office-random", seed, SimulationConfig(n_samples=3000))
    maps = [mm.build_map(s, SPLINE) for s in (pair.base, pair.target)]
    own, rows = mm.register(*maps), []
    n_anew = max(1, n_frames // 50)
    for title, n in (("maps carried along", n_frames), ("surveys mapped anew", n_anew)):
        strays = []
        for _ in range(n):
            A, B = random_transform(rng), random_transform(rng)
            if title.startswith("maps"):
                moved = maps[0].transformed(A), maps[1].transformed(B)
            else:
                moved = pair.base.transformed(A), pair.target.transformed(B)
            found = mm.register(*moved)
            T = None if found.T_base_target is None else A.inv() * found.T_base_target * B
            strays.append(stray(own, T))
        rows.append(row_of(f"{title}, {n} pairs of frames", strays))
    swapped = mm.register(maps[1], maps[0])
    found = swapped.T_base_target.inv() if swapped.T_base_target is not None else None
    return [*rows, row_of("base and target swapped", [stray(own, found)])]


def stray(own: mm.RegistrationResult, T: object) -> tuple[float, float, float]:
    """Largest deviation in standard deviations of the answer, and its turn (rad) and shift (m); inf where refused."""
    if T is None:
        return np.inf, np.inf, np.inf
    xi = (own.T_base_target.inv() * T).as_exp_coords()
    sd = np.sqrt(np.diag(own.covariance))
    return float(np.abs(xi / sd).max()), float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))


def row_of(title: str, strays: list[tuple[float, float, float]]) -> list[str]:
    """How many were accepted, and the largest deviation."""
    worst = np.max(strays, axis=0)
    accepted = np.isfinite(np.array(strays)[:, 0]).sum()
    return [title, str(accepted), f"{worst[0]:.1e} sd, {worst[1]:.1e} rad, {worst[2]:.1e} m"]


def main() -> None:
    asked = arguments(__doc__, ("growth", "frames"), frames=1000, seed=30, save_growth=saver, save_frames=saver)
    if "growth" in asked.words:
        show(GROWTH, grow(asked.seed), asked.save_growth)
    if "frames" in asked.words:
        show(FRAMES, turn(asked.seed, asked.frames), asked.save_frames)


if __name__ == "__main__":
    main()
