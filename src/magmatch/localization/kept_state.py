# SPDX-License-Identifier: BSD-3-Clause
"""A localizer's state as bytes, so that another process can continue from there, bit for bit.

The state is a tree of numbers, strings and dataclasses of this package, followed by their arrays; an array that two
of them share is stored once and shared again. Whatever follows from the maps and the settings is computed anew.
"""

import hashlib
import json
import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmatch._version import __version__
from magmatch.errors import DataFormatError
from magmatch.localization.belief import Belief
from magmatch.localization.bins import Bin, Binning
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import KnownPlaces, NotReadyError
from magmatch.localization.localizer import Localizer
from magmatch.localization.measurement import Window
from magmatch.localization.samples import Samples
from magmatch.localization.weigh_hypotheses import Weighed
from magmatch.registration.decide.posterior import Posterior

SCHEMA = "magmatch.localizer/4"
# What a state may consist of.
KINDS: dict[str, type] = {kind.__name__: kind for kind in (Bin, Binning, Posterior, Samples, Weighed, Window)}
# Of a belief and its null model: what follows from the map and the settings.
MADE_ANEW = {"_known", "_config", "_model", "_start"}


def state_of(localizer: Localizer) -> bytes:
    """Serialise the complete state of a localizer."""
    maps = localizer._maps
    arrays: dict[int, tuple[int, np.ndarray]] = {}
    tree = {
        "samples": localizer._samples,
        "binning": localizer._binning,
        "bins": maps._bins,
        "n_until_vote": maps._n_until_vote,
        "likely": [
            [None if entry is None else entry.name, maps.known.fingerprint(entry), _belief(belief)]
            for entry, belief in maps.likely.items()
        ],
    }
    head: dict[str, Any] = {"schema": SCHEMA, "version": __version__, "config": _config_of(localizer)}
    head["state"] = _frozen(tree, arrays)
    head["arrays"] = [[a.dtype.descr if a.dtype.names else a.dtype.str, a.shape] for _, a in arrays.values()]
    content = b"".join(np.ascontiguousarray(a).tobytes() for _, a in arrays.values())
    words = json.dumps(head, allow_nan=False).encode()
    digest = hashlib.sha256(words + content).hexdigest().encode()
    return digest + b"\n" + words + b"\n" + content


def restored(known: KnownPlaces, config: LocalizerConfig, state: bytes, path: str | Path = "state") -> Localizer:
    """Make a localizer that continues from another's state.

    Raises `DataFormatError` where that is damaged, of another version or other settings, or of maps that are no
    longer there; ``path`` names it. Raises `NotReadyError` where the loader of `known` has yet to make a map ready.
    """
    digest, _, rest = state.partition(b"\n")
    if hashlib.sha256(rest.replace(b"\n", b"", 1)).hexdigest().encode() != digest:
        raise DataFormatError(path, "is not a complete state of a localizer: wrong checksum")
    words, _, content = rest.partition(b"\n")
    head = json.loads(words)
    if (head["schema"], head["version"]) != (SCHEMA, __version__):
        was, expected = f"{head['schema']} of {head['version']}", f"{SCHEMA} of {__version__}"
        raise DataFormatError(path, f"is of version {was}, expected {expected}")
    localizer = Localizer(known, config)
    if head["config"] != _config_of(localizer):
        raise DataFormatError(path, "is of other settings")
    arrays, at = [], 0
    for kind, shape in head["arrays"]:
        row = kind if isinstance(kind, str) else [(name, of, *map(tuple, rest)) for name, of, *rest in kind]
        # Loops write into them.
        arrays.append(np.frombuffer(content, row, math.prod(shape), at).reshape(shape).copy())
        at += arrays[-1].nbytes
    tree = _thawed(head["state"], arrays)
    localizer._samples, localizer._binning, maps = tree["samples"], tree["binning"], localizer._maps
    maps._bins, maps._n_until_vote, maps.likely = tree["bins"], tree["n_until_vote"], {}
    entries = {None if entry is None else entry.name: entry for entry in known.entries}
    for name, fingerprint, _ in tree["likely"]:
        if name not in entries or known.fingerprint(entries[name]) != fingerprint:
            raise DataFormatError(path, f"is of another version of the map {name or ''}".rstrip())
    ready = [known.soon(entries[name]) for name, *_ in tree["likely"]]
    for one, (name, _, kept) in zip(ready, tree["likely"], strict=True):
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
    kept["_window"] = belief._window.trimmed()
    return kept | {"_null": {name: v for name, v in vars(belief._null).items() if name not in MADE_ANEW}}


def _frozen(value: Any, arrays: dict[int, tuple[int, np.ndarray]]) -> Any:
    """A value as JSON: lists are lists, all else that JSON lacks is an object with one key."""
    if isinstance(value, np.ndarray):
        return {"array": arrays.setdefault(id(value), (len(arrays), value))[0]}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return {"number": repr(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple):
        parts = [_frozen(v, arrays) for v in value]
        return parts if isinstance(value, list) else {"tuple": parts}
    if isinstance(value, dict):
        return {"dict": {key: _frozen(v, arrays) for key, v in value.items()}}
    if is_dataclass(value) and KINDS.get(type(value).__name__) is type(value):
        return {type(value).__name__: [_frozen(getattr(value, f.name), arrays) for f in fields(value)]}
    msg = f"a localizer's state holds a {type(value).__name__}: expected numbers, arrays or one of {', '.join(KINDS)}"
    raise TypeError(msg)


def _thawed(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, list):
        return [_thawed(v, arrays) for v in value]
    if not isinstance(value, dict):
        return value
    ((kind, inner),) = value.items()
    if kind in {"array", "number"}:
        return arrays[inner] if kind == "array" else float(inner)
    if kind == "tuple":
        return tuple(_thawed(v, arrays) for v in inner)
    if kind == "dict":
        return {key: _thawed(v, arrays) for key, v in inner.items()}
    return KINDS[kind](*(_thawed(v, arrays) for v in inner))
