# SPDX-License-Identifier: BSD-3-Clause
"""A localizer's state as a tree of `magmatch.store`, so that another process can continue there, bit for bit.

Whatever follows from the maps and the settings is computed anew.
"""

from typing import Any

from magmatch._version import __version__
from magmatch.errors import DataFormatError
from magmatch.estimation.posterior import Answer, Posterior
from magmatch.localization.belief import Belief
from magmatch.localization.bins import Binning
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import KnownPlaces, NotReadyError
from magmatch.localization.likely_maps import LikelyMaps
from magmatch.localization.localizer import Localizer
from magmatch.localization.measurement import LatestBins
from magmatch.localization.samples import LastSample
from magmatch.localization.weigh_hypotheses import WeighedHypothesis

# What a state may consist of, and changes with.
SCHEMA = "magmatch.localizer/10"
STATE = "state"  # what errors call it
KINDS = (Answer, Binning, Posterior, LastSample, WeighedHypothesis, LatestBins)
# Of a belief, what follows from the map and the settings.
MADE_ANEW = {"_known", "_config", "_model", "unrelated"}


def state_of(localizer: Localizer) -> dict[str, Any]:
    """Give the complete state of a localizer; its arrays are the localizer's own, which it goes on to write into."""
    return {
        "written_by": [SCHEMA, __version__],
        "config": _config_of(localizer),
        "samples": localizer._samples,
        "binning": localizer._binning,
        "is_refuted": localizer._is_refuted,
        "maps": [_likely_maps(maps) for maps in (localizer._maps, localizer._anew) if maps is not None],
    }


def restored(known: KnownPlaces, config: LocalizerConfig, state: dict[str, Any]) -> Localizer:
    """Make a localizer that continues from another's state, which becomes its own.

    Raises `DataFormatError` where that is of another version or other settings, or of maps that are no longer there,
    and `NotReadyError` where the loader of `known` has yet to make a map ready.
    """
    if state["written_by"] != [SCHEMA, __version__]:
        raise DataFormatError(STATE, f"is of version {state['written_by']}, expected {[SCHEMA, __version__]}")
    localizer = Localizer(known, config)
    if state["config"] != _config_of(localizer):
        raise DataFormatError(STATE, "is of other settings")
    localizer._samples, localizer._binning = state["samples"], state["binning"]
    localizer._is_refuted = state["is_refuted"]
    kept_maps = [likely for maps in state["maps"] for likely in maps["likely"]]
    entries = {None if entry is None else entry.name: entry for entry in known.entries}
    for name, fingerprint, _ in kept_maps:
        if name not in entries or known.fingerprint(entries[name]) != fingerprint:
            raise DataFormatError(STATE, f"is of another version of the map {name or ''}".rstrip())
    soon = {name: known.soon(entries[name]) for name, *_ in kept_maps}
    ready = {name: one for name, one in soon.items() if one is not None}
    if len(ready) < len(soon):
        raise NotReadyError
    # The second, if there is one, is what the path since the first's map was left says by itself.
    config = localizer._maps.config  # settled
    looks = [localizer._maps, LikelyMaps(known, config)][: len(state["maps"])]
    for maps, kept in zip(looks, state["maps"], strict=True):
        maps._bins, maps._n_until_vote, maps.likely = kept["bins"], kept["n_until_vote"], {}
        for name, _, of_belief in kept["likely"]:
            belief = maps.likely[entries[name]] = Belief(ready[name], config)
            belief.unrelated.now = of_belief.pop("unrelated")
            vars(belief).update(of_belief)
    localizer._maps, localizer._anew, *_ = *looks, None
    return localizer


def _config_of(localizer: Localizer) -> Any:
    return localizer._maps.config.model_dump(mode="json")


def _likely_maps(maps: LikelyMaps) -> dict[str, Any]:
    likely = [
        [None if entry is None else entry.name, maps.known.fingerprint(entry), _belief(belief)]
        for entry, belief in maps.likely.items()
    ]
    return {"bins": maps._bins, "n_until_vote": maps._n_until_vote, "likely": likely}


def _belief(belief: Belief) -> dict[str, Any]:
    kept = {name: value for name, value in vars(belief).items() if name not in MADE_ANEW}
    return kept | {"unrelated": belief.unrelated.now}
