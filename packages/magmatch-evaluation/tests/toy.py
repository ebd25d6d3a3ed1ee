# SPDX-License-Identifier: BSD-3-Clause
"""An evaluation without any physics: `python toy.py FOLDER` runs it, slowly enough to be interrupted."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmatch.data.survey import Survey
from magmatch.geometry import random_transform
from magmatch.registration.result import RegistrationResult, Status
from magmatch_evaluation.benchmark import evaluate
from magmatch_evaluation.experiments import Experiment
from magmatch_evaluation.findings import Findings, result_tables
from magmatch_evaluation.plan import Plan, make_plan
from magmatch_evaluation.survey_pairs import SurveyPair


@dataclass(frozen=True)
class ToyPair:
    """A few random samples, twice."""

    n_samples: int = 12

    def __call__(self, seed: int, recordings: Path | None = None) -> SurveyPair:
        rng = np.random.default_rng(seed)
        survey = Survey(rng.uniform(-1, 1, (self.n_samples, 3)), 1e-6 * rng.standard_normal((self.n_samples, 3)))
        T_base_target = random_transform(rng)
        return SurveyPair(survey, survey.transformed(T_base_target.inv()), T_base_target, accept=seed % 4 != 3)


@dataclass(frozen=True)
class Spoilt:
    """Answers with the rough start; writes down that it was asked."""

    name: str
    calls: str = ""
    seconds: float = 0.0
    faulty_seed: int = -1
    title: str = "the truth, spoilt"
    module: str | None = None

    def __repr__(self) -> str:
        return f"Spoilt({self.name})"

    def __call__(self, task):
        time.sleep(self.seconds)
        if self.calls:
            with Path(self.calls).open("a") as stream:
                stream.write(f"{self.name} {task.seed}\n")
        if task.seed == self.faulty_seed:
            raise ValueError("broke\ndown")
        if task.seed % 5 == 4:
            return RegistrationResult(Status.INCONSISTENT, "does not fit", None)
        return RegistrationResult(Status.ACCEPTED, "fits", task.rough_start)


def toy_experiment(name: str = "toy", n_seeds: int = 10, n_samples: int = 12, **more) -> Experiment:
    return Experiment(name, "a toy", "toys", ToyPair(n_samples), n_seeds, ("one", "two"), **more)


def toy_plan(calls: str = "", seconds: float = 0.0) -> Plan:
    methods = {name: Spoilt(name, calls, seconds) for name in ("one", "two")}
    return make_plan([toy_experiment("toy"), toy_experiment("other", n_samples=13)], methods)


def toy_findings(plan: Plan, rows) -> Findings:
    return Findings(plan.experiments, rows, plan.left_out, "magmatch evaluate toys")


def tables(plan: Plan, rows) -> str:
    return "\n".join(table.markdown() for table in result_tables(toy_findings(plan, rows)))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    plan = toy_plan(str(folder / "calls.txt"), seconds=0.02)
    rows = evaluate(plan, folder)
    (folder / "results.md").write_text(tables(plan, rows))
