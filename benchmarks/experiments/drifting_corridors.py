"""Corridors walked twice, blind: how often the pose is found, by how far positions drift.

    python benchmarks/experiments/drifting_corridors.py [--seeds 40] [--first 0] [--drifts 0 0.02 0.05 0.1]
        [--quick] [--save NAME]

Drift is in metres per square root of a metre, of both walks. Right: accepted, within three stated standard
deviations in every direction together (chi-square of six). Inaccurate: refused for accuracy alone. Wrong: accepted,
more than 1.5 m or 8 degrees off. NEES: normalised estimation error squared of accepted poses, over 6: 1 where
covariances are right. Errors are of accepted poses, at the target's centre. The last row registers each target with
the corridor before it, which is another one. ``--quick``: a quarter of the seeds.
"""

import logging

import numpy as np
from scipy.special import chdtri

import magmatch as mm
from magmatch.field.config import SPLINE
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import RegistrationResult, Status
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import SimulatedPair
from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments, pose_error
from magmatch_evaluation.statistics import wilson_interval
from magmatch_evaluation.trial import nees_of

COLUMNS = (
    "drift, m/sqrt(m)", "prior", "n", "accepted", "right", "inaccurate", "wrong", "best pose right",
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
    row = {"best": float(is_near), "inaccurate": float(result.status is Status.DEGENERATE)}
    if not np.isfinite(nees):
        return row
    return row | {
        "accepted": 1.0, "right": float(6 * nees < WITHIN), "wrong": float(not is_near), "nees": nees,
        "metres": metres, "degrees": degrees,
    }  # fmt: skip


def main() -> None:
    asked = arguments(__doc__, seeds=40, first=0, drifts=[0.0, 0.02, 0.05, 0.1], quick=False, save=saver)
    logging.getLogger("magmatch").setLevel(logging.ERROR)
    n = asked.seeds // 4 if asked.quick else asked.seeds
    lines = []
    for drift in asked.drifts:
        rows: dict[str, list[dict[str, float]]] = {"any pose": [], "`--gravity-aligned`": [], "another place": []}
        before: mm.FieldMap | None = None
        for seed in range(asked.first, asked.first + n):
            pair = mm.simulate("corridor", seed, SimulationConfig(pose_drift=drift))
            base = mm.build_map(pair.base, SPLINE)
            for prior, aligned in (("any pose", False), ("`--gravity-aligned`", True)):
                rows[prior].append(judged(register(base, pair.target, aligned=aligned), pair))
            if before is not None:
                accepted = register(before, pair.target, aligned=False).is_accepted
                rows["another place"].append({"accepted": float(accepted), "wrong": float(accepted)})
            before = base
        lines += [line(f"{drift:g}", prior, found) for prior, found in rows.items() if found]
        for one in lines[-3:]:
            print(" | ".join(one), flush=True)
    show(COLUMNS, lines, asked.save)


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

    shown = [count(name) for name in ("accepted", "right", "inaccurate", "wrong", "best")]
    return [drift, prior, str(n), *shown, middle("metres"), middle("degrees"), middle("nees", np.mean)]


if __name__ == "__main__":
    main()
