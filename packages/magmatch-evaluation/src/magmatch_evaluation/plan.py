# SPDX-License-Identifier: BSD-3-Clause
"""What a run consists of: which trials, which of them are left to do, and what had to be left out and why."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from magmatch.data.datasets import cache_folder, verified_files
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch_evaluation.experiments import EXPERIMENTS, QUICK, Experiment
from magmatch_evaluation.held_out_field import PREDICTORS
from magmatch_evaluation.methods import METHODS, Method
from magmatch_evaluation.rows import Key
from magmatch_evaluation.trial import Batch

ALL: dict[str, Method] = {**METHODS, **PREDICTORS}


@dataclass(frozen=True, slots=True)
class Plan:
    """All trials of a run, and what cannot be run here and why.

    The first seeds of all experiments come first, so that a run that was stopped has something of everything.
    """

    batches: tuple[Batch, ...]
    left_out: Mapping[str, str]

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """Experiments that have trials, in order."""
        return tuple({batch.experiment.name: batch.experiment for batch in self.batches}.values())

    def keys(self) -> set[Key]:
        """Keys of the rows that the whole run gives."""
        return {key for batch in self.batches for key in batch.row_keys()}

    def remaining(self, done: Container[Key]) -> list[Batch]:
        """Batches with the methods whose rows are not there yet."""
        cut = [
            replace(b, methods=tuple(m for m, key in zip(b.methods, b.row_keys(), strict=True) if key not in done))
            for b in self.batches
        ]
        return [batch for batch in cut if batch.methods]


def make_plan(
    experiments: Sequence[Experiment],
    methods: Mapping[str, Method],
    *,
    n_seeds: int | None = None,
    first_seed: int = 1000,
    recordings: Path | None = None,
) -> Plan:
    """Lay out the trials of a run.

    Methods are those that may be asked: an experiment's others are not. ``n_seeds`` bounds each experiment's own
    number; recordings are by default those in the cache that ``magmatch datasets fetch`` fills.
    """
    folder = recordings or cache_folder()
    absent = {name: m.module for name, m in methods.items() if m.module is not None and not find_spec(m.module)}
    missing = _missing_recordings({e.dataset for e in experiments if e.dataset}, folder)
    left_out = {f"method {name}": f"{module} is not installed" for name, module in absent.items()}
    left_out |= {f"experiment {e.name}": missing[e.dataset] for e in experiments if e.dataset in missing}
    batches = [
        Batch(e, seed, tuple(methods[name] for name in e.methods if name in methods.keys() - absent.keys()), folder)
        for e in experiments if e.dataset not in missing
        for seed in range(first_seed, first_seed + min(e.n_seeds, n_seeds or e.n_seeds))
    ]  # fmt: skip
    batches.sort(key=lambda batch: batch.seed)
    return Plan(tuple(batch for batch in batches if batch.methods), left_out)


def chosen_experiments(names: Sequence[str], *, quick: bool = False) -> list[Experiment]:
    """Find experiments, or the small ones, by their names or those of their groups; all where no name is given."""
    catalogue = QUICK if quick else EXPERIMENTS
    groups = dict.fromkeys(e.group for e in catalogue.values())
    for name in names:
        if name not in catalogue and name not in groups:
            msg = f"no experiment '{name}'; there are the groups {', '.join(groups)} and {', '.join(catalogue)}"
            raise ConfigurationError(msg)
    return [e for e in catalogue.values() if not names or e.name in names or e.group in names]


def chosen_methods(names: str | None) -> dict[str, Method]:
    """Find methods and predictors by their names, separated by commas; all unless given."""
    asked = names.split(",") if names else list(ALL)
    for name in asked:
        if name not in ALL:
            msg = f"no method '{name}'; there are {', '.join(ALL)}"
            raise ConfigurationError(msg)
    return {name: ALL[name] for name in asked}


def _missing_recordings(datasets: set[str], folder: Path) -> dict[str | None, str]:
    """Recordings that cannot be used here, each with the reason."""
    missing = dict[str | None, str]()
    for name in sorted(datasets):
        try:
            verified_files(name, folder)
        except DataFormatError as error:
            fetching = f"fetch it with 'magmatch datasets fetch {name}'"
            missing[name] = f"recording '{name}' is not here ({error}); {fetching}"
    return missing
