# SPDX-License-Identifier: BSD-3-Clause
"""The named experiments: the published ones as equivalents, refusals, harder conditions, public recordings."""

from magmatch.evaluation.experiment import Experiment, Tolerance
from magmatch.evaluation.simulated import Simulated
from magmatch.simulation.config import SimulationConfig

ALL_METHODS = ("default", "paper")
N_PUBLISHED, N_REFUSALS = 20, 20
WALK = Tolerance(0.25, 5.0)


def _published() -> list[Experiment]:
    """Equivalents of the published experiments: the published data are not public."""

    def one(name: str, scenario: str, title: str, tolerance: Tolerance | None = None) -> Experiment:
        make = Simulated(scenario)
        return Experiment(name, title, "published", make, N_PUBLISHED, ALL_METHODS, tolerance or Tolerance())

    return [
        one("office-z30", "office-z30", "office room, target turned by 30 deg about z (gravity aligned)"),
        one("office-x30", "office-x30", "office room, target turned by -30 deg about x"),
        one("table-map", "table", "table, rows along against rows across, 20 deg about y and z"),
        one("table-robot", "table-robot", "robot in circles 0.05 m above the table, in the table's map"),
        one("corridor", "corridor", "a stretch of corridor walked twice by dead reckoning", WALK),
    ]


def _refusals() -> list[Experiment]:
    """Pairs that nothing must be accepted for."""
    return [
        Experiment(name, title, "refusals", Simulated(name), N_REFUSALS, ALL_METHODS)
        for name, title in (("nowhere", "two different rooms"), ("uniform", "Earth's field and noise alone"))
    ]


EXPERIMENTS: dict[str, Experiment] = {e.name: e for e in (*_published(), *_refusals())}

# Under two minutes on one core: smaller surveys, few seeds.
QUICK: dict[str, Experiment] = {
    f"quick-{scenario}": Experiment(
        f"quick-{scenario}", f"{EXPERIMENTS[scenario].title}; 600 samples", EXPERIMENTS[scenario].group,
        Simulated(scenario, SimulationConfig(n_samples=600)), 2, ALL_METHODS,
    )
    for scenario in ("office-x30", "nowhere")
}  # fmt: skip
