# SPDX-License-Identifier: BSD-3-Clause
"""Which experiments and methods somebody asked for by name."""

from collections.abc import Sequence

from magmatch.errors import ConfigurationError
from magmatch.evaluation.experiment import Experiment
from magmatch.evaluation.experiments import EXPERIMENTS, QUICK
from magmatch.evaluation.method import Method
from magmatch.evaluation.methods import METHODS


def chosen_experiments(names: Sequence[str] | None, *, quick: bool = False) -> list[Experiment]:
    """Find experiments by their names or those of their groups.

    Parameters
    ----------
    names : sequence of str, optional
        All unless given.
    quick : bool
        Choose among the small ones.

    Returns
    -------
    list of Experiment
        In the order of the catalogue.

    Raises
    ------
    ConfigurationError
        No such name; lists those there are.
    """
    catalogue = QUICK if quick else EXPERIMENTS
    groups = dict.fromkeys(e.group for e in catalogue.values())
    for name in names or ():
        if name not in catalogue and name not in groups:
            msg = f"no experiment '{name}'; there are the groups {', '.join(groups)} and {', '.join(catalogue)}"
            raise ConfigurationError(msg)
    return [e for e in catalogue.values() if not names or e.name in names or e.group in names]


def chosen_methods(names: str | None) -> dict[str, Method]:
    """Find methods by their names, separated by commas; all unless given."""
    asked = names.split(",") if names else list(METHODS)
    for name in asked:
        if name not in METHODS:
            msg = f"no method '{name}'; there are {', '.join(METHODS)}"
            raise ConfigurationError(msg)
    return {name: METHODS[name] for name in asked}
