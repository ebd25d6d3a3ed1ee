# SPDX-License-Identifier: BSD-3-Clause
"""A localizer's state as a tree of `magmatch.store`, so that another process can continue there, bit for bit.

Whatever follows from the maps and the settings is computed anew.
"""

from pathlib import Path
from typing import Any

from magmatch._version import __version__
from magmatch.errors import DataFormatError
from magmatch.estimation.posterior import Answer, Posterior
from magmatch.localization.belief import Belief
from magmatch.localization.bins import Bin, Binning
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import KnownPlaces, NotReadyError
from magmatch.localization.localizer import Localizer
from magmatch.localization.measurement import LatestBins
from magmatch.localization.samples import LastSample
from magmatch.localization.weigh_hypotheses import WeighedHypothesis

# What a state may consist of, and changes with.
SCHEMA = "magmatch.localizer/8"
KINDS = (Answer, Bin, Binning, Posterior, LastSample, WeighedHypothesis, LatestBins)
# Of a belief and its null model: what follows from the map and the settings.
MADE_ANEW = {"_known", "_config", "_model", "_start"}


def state_of(localizer: Localizer) -> dict[str, Any]:
    """Give the complete state of a localizer; its arrays are the localizer's own, which it goes on to write into."""
    maps = localizer._maps
    return {
        "written_by": [SCHEMA, __version__],
        "config": _config_of(localizer),
        "samples": localizer._samples,
        "binning": localizer._binning,
        "bins": maps._bins,
        "n_until_vote": maps._n_until_vote,
        "likely": [
            [None if entry is None else entry.name, maps.known.fingerprint(entry), _belief(belief)]
            for entry, belief in maps.likely.items()
        ],
    }


def restored(
    known: KnownPlaces, config: LocalizerConfig, state: dict[str, Any], path: str | Path = "state"
) -> Localizer:
    """Make a localizer that continues from another's state, which becomes its own.

    Raises `DataFormatError` where that is of another version or other settings, or of maps that are no longer there;
    ``path`` names it. Raises `NotReadyError` where the loader of `known` has yet to make a map ready.
    """
    if state["written_by"] != [SCHEMA, __version__]:
        raise DataFormatError(path, f"is of version {state['written_by']}, expected {[SCHEMA, __version__]}")
    localizer = Localizer(known, config)
    if state["config"] != _config_of(localizer):
        raise DataFormatError(path, "is of other settings")
    localizer._samples, localizer._binning, maps = state["samples"], state["binning"], localizer._maps
    maps._bins, maps._n_until_vote, maps.likely = state["bins"], state["n_until_vote"], {}
    entries = {None if entry is None else entry.name: entry for entry in known.entries}
    for name, fingerprint, _ in state["likely"]:
        if name not in entries or known.fingerprint(entries[name]) != fingerprint:
            raise DataFormatError(path, f"is of another version of the map {name or ''}".rstrip())
    ready = [known.soon(entries[name]) for name, *_ in state["likely"]]
    for one, (name, _, kept) in zip(ready, state["likely"], strict=True):
        if one is None:
            raise NotReadyError
        belief = Belief(one, config)
        vars(belief._null).update(kept.pop("_null"))
        vars(belief).update(kept)
        maps.likely[entries[name]] = belief
    return localizer


def _config_of(localizer: Localizer) -> Any:
    return localizer._maps._config.model_dump(mode="json")


def _belief(belief: Belief) -> dict[str, Any]:
    kept = {name: value for name, value in vars(belief).items() if name not in MADE_ANEW}
    return kept | {"_null": {name: v for name, v in vars(belief._null).items() if name not in MADE_ANEW}}
