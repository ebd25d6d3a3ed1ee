# SPDX-License-Identifier: BSD-3-Clause
"""Intermediate results of a search for closures, stored so that an interrupted search can resume.

A run always takes the same steps in the same order, so the n-th stored result is that of the n-th step. Results are
stored as plain numbers, from which those who ask make what they need with or without an interruption, so that the
bits are the same.
"""

import hashlib
import json
import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from magmatch.data.document import read_document, write_document
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.typing import Matrix

log = logging.getLogger(__name__)

SCHEMA = "magmatch.slam.steps/8"
MAX_BYTES = 256 * 1024**2
# Seconds of work that a power cut may cost.
KEEP_EVERY_S = 5.0


class Steps:
    """Results of steps, in their order; without a folder, which is created, they are not stored.

    ``of`` is the input of the steps, in JSON's types: results for any other input are deleted.
    """

    def __init__(self, folder: str | Path | None = None, **of: Any) -> None:
        self.folder = folder = None if folder is None else Path(folder)
        self._of = hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()[:15]
        self._kept: list[Any] = []
        self._new: list[Any] = []
        self._n_written, self._written = 0, monotonic()
        if folder is not None:
            if not folder.resolve().parent.is_dir():
                msg = f"keep: the folder {folder.resolve().parent} does not exist; create it first"
                raise ConfigurationError(msg)
            if folder.exists() and not folder.is_dir():
                msg = f"keep: {folder} is a file, expected the name of a folder"
                raise ConfigurationError(msg)
            self._read(folder)
        if self._kept:
            log.info("going on after %d steps that were kept in %s", len(self._kept), folder)

    def __call__(self, step: Callable[[], Matrix]) -> Matrix:
        """Give the result of the next step: the stored one, else a new one."""
        if self._kept:
            return np.array(self._kept.pop(0), dtype=np.float64)
        found = step()
        if self.folder is not None:
            self._new.append(found.tolist())
            if monotonic() - self._written > KEEP_EVERY_S:
                self.keep()
        return found

    @property
    def n_kept(self) -> int:
        """Stored results of the steps to come."""
        return len(self._kept)

    def keep(self) -> None:
        """Write what was found since the last time."""
        if self.folder is None or not self._new:
            return
        self.folder.mkdir(exist_ok=True)
        document = {"schema": SCHEMA, "of": self._of, "results": self._new}
        write_document(self.folder / f"{self._n_written}.json", document)
        self._n_written, self._new, self._written = self._n_written + len(self._new), [], monotonic()

    def _read(self, folder: Path) -> None:
        """Each file is named by how many results stand before it."""
        while (path := folder / f"{len(self._kept)}.json").is_file():
            try:
                document = read_document(path, SCHEMA, "part of a search for closures", MAX_BYTES)
            except DataFormatError:
                break
            if document.get("of") != self._of or not document["results"]:
                break
            self._kept += document["results"]
        self._n_written = len(self._kept)
        if not self._kept:
            # Of another input; whatever else lies there is somebody's.
            for path in folder.glob("*.json"):
                if path.stem.isdigit():
                    path.unlink()
            with suppress(OSError):
                folder.rmdir()
