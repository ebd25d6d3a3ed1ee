# SPDX-License-Identifier: BSD-3-Clause
"""A simulated pair as files."""

import json
from pathlib import Path

from magmatch._version import __version__
from magmatch.atomic import atomic_write
from magmatch.simulation.scene import SimulatedPair


def write_pair(pair: SimulatedPair, folder: str | Path) -> None:
    """Write ``base.csv``, ``target.csv`` and, last, ``truth.json``, each whole or not at all."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    truth = {
        "T_base_target": pair.T_base_target.as_matrix().tolist(),
        "accept": pair.accept,
        "scenario": pair.scenario,
        "seed": pair.seed,
        "version": __version__,
        "config": pair.config.model_dump(mode="json"),
    }
    pair.base.save(folder / "base.csv")
    pair.target.save(folder / "target.csv")
    with atomic_write(folder / "truth.json") as stream:
        stream.write(json.dumps(truth, indent=2).encode() + b"\n")
