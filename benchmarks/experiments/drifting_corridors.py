"""Corridors walked twice, blind: how often the pose is found, by how far positions drift.

    python benchmarks/experiments/drifting_corridors.py --out DIR [--seeds 40] [--first 0]
        [--drifts 0 0.02 0.05 0.1] [--jobs 2] [--quick] [--save NAME]

Drift is in metres per square root of a metre, of both walks. Right: accepted, within three stated standard
deviations in every direction together (chi-square of six). Inaccurate: refused for accuracy alone. Wrong: accepted,
more than 1.5 m or 8 degrees off. NEES: normalised estimation error squared of accepted poses, over 6: 1 where
covariances are right. Errors are of accepted poses, at the target's centre. The last row registers each target with
the corridor of the next seed, which is another one. Rows stay in DIR, a second run goes on where the first
ended. ``--quick``: a quarter of the seeds.
"""

import logging
import os
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import chdtri

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import RegistrationResult, Status
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.scene import SimulatedPair
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, kept, pose_error
from magmatch_evaluation.statistics import wilson_interval
from magmatch_evaluation.trial import nees_of

COLUMNS = (
    "drift, m/sqrt(m)", "prior", "n", "accepted", "right", "wrong", "inaccurate", "refused", "best pose right",
    "median error, m", "rotation, deg", "NEES",
)  # fmt: skip
# Three standard deviations of one number leave out as much as this of six.
WITHIN = float(chdtri(6, 0.0027))


def register(base: mm.FieldMap, target: mm.Survey, *, aligned: bool) -> RegistrationResult:
    config = RegistrationConfig.model_validate({"prior": {"is_gravity_aligned": aligned}})
    return mm.register(base, target, config)


def judged(result: RegistrationResult, pair: SimulatedPair) -> dict[str, float]:
    """What became of a pair."""
    metres, angle = pose_error(result, pair.T_base_target, pair.target.centroid)
    degrees, nees = float(np.degrees(angle)), nees_of(result, pair.T_base_target)
    is_near = metres < 1.5 and degrees < 8
    is_inaccurate = result.status is Status.DEGENERATE
    row = {"best": float(is_near), "inaccurate": float(is_inaccurate)}
    if not np.isfinite(nees):
        return row | {"refused": float(not is_inaccurate)}
    return row | {
        "accepted": 1.0, "right": float(6 * nees < WITHIN), "wrong": float(not is_near), "nees": nees,
        "metres": metres, "degrees": degrees,
    }  # fmt: skip


def corridor(name: str) -> dict[str, dict[str, float]]:
    """Register one corridor under each prior, and its target with another one: name is ``DRIFT SEED``."""
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    drift, seed = name.split()
    config = SimulationConfig(pose_drift=float(drift))
    pair, after = (mm.simulate("corridor", int(seed) + k, config) for k in (0, 1))
    base, other = (mm.build_map(one.base, SPLINE) for one in (pair, after))
    priors = {"any pose": False, "`--gravity-aligned`": True}
    rows = {prior: judged(register(base, pair.target, aligned=aligned), pair) for prior, aligned in priors.items()}
    accepted = float(register(other, pair.target, aligned=False).is_accepted)
    return rows | {"another place": {"accepted": accepted, "wrong": accepted, "refused": 1 - accepted}}


def main() -> None:
    asked = arguments(
        __doc__, out=Path, seeds=40, first=0, drifts=[0.0, 0.02, 0.05, 0.1], jobs=os.cpu_count(), quick=False,
        save=saver,
    )  # fmt: skip
    n = asked.seeds // 4 if asked.quick else asked.seeds
    names = [f"{drift:g} {seed}" for drift, seed in product(asked.drifts, range(asked.first, asked.first + n))]
    found = kept(asked.out / "corridors.jsonl", names, corridor, jobs=asked.jobs)
    lines = [
        line(f"{drift:g}", prior, [row[prior] for name, row in found.items() if name.startswith(f"{drift:g} ")])
        for drift, prior in product(asked.drifts, ("any pose", "`--gravity-aligned`", "another place"))
    ]
    show(COLUMNS, lines, asked.save, found.values())


def line(drift: str, prior: str, rows: list[dict[str, float]]) -> list[str]:
    """One row of the table."""
    n = len(rows)

    def count(name: str) -> str:
        k = int(sum(row.get(name, 0.0) for row in rows))
        low, high = wilson_interval(k, n)
        return f"{k} ({100 * low:.0f}-{100 * high:.0f} %)"

    def middle(name: str, of: object = np.median) -> str:
        values = [row[name] for row in rows if name in row]
        return f"{of(values):.3g}" if values else ""  # type: ignore[operator]

    shown = [count(name) for name in ("accepted", "right", "wrong", "inaccurate", "refused", "best")]
    return [drift, prior, str(n), *shown, middle("metres"), middle("degrees"), middle("nees", np.mean)]


if __name__ == "__main__":
    main()
