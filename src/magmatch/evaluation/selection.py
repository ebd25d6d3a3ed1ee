# SPDX-License-Identifier: BSD-3-Clause
"""Which experiments and methods somebody asked for by name."""

from collections.abc import Sequence

from magmatch.errors import ConfigurationError
from magmatch.evaluation.experiment import Experiment
from magmatch.evaluation.experiments import EXPERIMENTS, QUICK
from magmatch.evaluation.mapping import CASES, MappingCase
from magmatch.evaluation.method import Method
from magmatch.evaluation.methods import METHODS

# Name of the group of all cases of the mapping table.
MAPPING = "mapping"


def chosen_cases(names: Sequence[str] | None) -> list[MappingCase]:
    """Find cases of the mapping table by their names, or all of them by 'mapping' or by no name at all."""
    return [case for case in CASES.values() if not names or case.name in names or MAPPING in names]


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
        if name not in catalogue and name not in groups and name not in CASES and name != MAPPING:
            there = ", ".join((*groups, MAPPING)), ", ".join((*catalogue, *CASES))
            msg = f"no experiment '{name}'; there are the groups {there[0]} and {there[1]}"
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
