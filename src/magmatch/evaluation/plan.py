# SPDX-License-Identifier: BSD-3-Clause
"""What a run consists of: which trials, which of them are left to do, and what had to be left out and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from magmatch.data.datasets import cache_folder, verified_files
from magmatch.errors import DataFormatError
from magmatch.evaluation.experiment import Experiment
from magmatch.evaluation.method import Method
from magmatch.evaluation.rows import Row
from magmatch.evaluation.trial import Batch, digest_of

Key = tuple[str, str, int, str]


@dataclass(frozen=True, slots=True)
class Plan:
    """All trials of a run.

    Attributes
    ----------
    batches : tuple of Batch
        First seeds of all experiments first, so that a run that was stopped has something of everything.
    left_out : dict of str to str
        Experiments and methods that cannot be run here, and why.
    """

    batches: tuple[Batch, ...]
    left_out: Mapping[str, str]

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """Experiments that have trials, in order."""
        return tuple({batch.experiment.name: batch.experiment for batch in self.batches}.values())

    def keys(self) -> set[Key]:
        """Keys of the rows that the whole run gives."""
        return {key for batch in self.batches for key in _keys(batch)}

    def remaining(self, rows: Sequence[Row]) -> list[Batch]:
        """Batches with the methods whose rows are not there yet."""
        done = {row.key for row in rows}
        cut = [
            replace(b, methods=tuple(m for m, key in zip(b.methods, _keys(b), strict=True) if key not in done))
            for b in self.batches
        ]
        return [batch for batch in cut if batch.methods]


def make_plan(
    experiments: Sequence[Experiment],
    methods: Mapping[str, Method],
    *,
    n_seeds: int | None = None,
    first_seed: int = 0,
    recordings: Path | None = None,
) -> Plan:
    """Lay out the trials of a run.

    Parameters
    ----------
    experiments : sequence of Experiment
    methods : dict of str to Method
        Those that may be asked; an experiment's other methods are not.
    n_seeds : int, optional
        Most trials of each experiment and method; each experiment's own number by default.
    first_seed : int
    recordings : Path, optional
        Folder of public recordings; by default the cache that ``magmatch datasets fetch`` fills.

    Returns
    -------
    Plan
    """
    folder = recordings or cache_folder()
    usable = {name: method for name, method in methods.items() if method.module is None or find_spec(method.module)}
    left_out = {
        f"method {m.name}": f"{m.module} is not installed (extra 'evaluate')"
        for name, m in methods.items() if name not in usable
    }  # fmt: skip
    missing = missing_recordings({e.dataset for e in experiments}, recordings)
    left_out |= {f"experiment {e.name}": missing[e.dataset] for e in experiments if e.dataset in missing}
    batches = [
        Batch(e, seed, tuple(usable[name] for name in e.methods if name in usable), folder)
        for e in experiments if e.dataset not in missing
        for seed in range(first_seed, first_seed + min(e.n_seeds, n_seeds or e.n_seeds))
    ]  # fmt: skip
    batches.sort(key=lambda batch: batch.seed)
    return Plan(tuple(batch for batch in batches if batch.methods), left_out)


def missing_recordings(datasets: set[str | None], recordings: Path | None) -> dict[str | None, str]:
    """Say which recordings cannot be used here, and why.

    Parameters
    ----------
    datasets : set of str
        Names; None stands for none and is never missing.
    recordings : Path, optional
        Folder; the cache by default.

    Returns
    -------
    dict of str to str
        Reason by name.
    """
    folder, missing = recordings or cache_folder(), dict[str | None, str]()
    for name in sorted(name for name in datasets if name):
        try:
            verified_files(name, folder / name if (folder / name).is_dir() else folder)
        except DataFormatError as error:
            fetching = f"fetch it with 'magmatch datasets fetch {name}'"
            missing[name] = f"recording '{name}' is not here ({error}); {fetching}"
    return missing


def _keys(batch: Batch) -> list[Key]:
    return [(batch.experiment.name, m.name, batch.seed, digest_of(batch.experiment, m)) for m in batch.methods]
