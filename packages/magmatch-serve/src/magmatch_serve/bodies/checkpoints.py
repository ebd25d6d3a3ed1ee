# SPDX-License-Identifier: BSD-3-Clause
"""States of clients in a folder: one file each, named by the client's id, written whole or not at all.

Logs that are worked on lie there for as long, each in a folder of its own.
"""

import fcntl
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time

from magmatch.errors import ConfigurationError

NAME = re.compile(r"[0-9a-f]{24}\.state")
# What folders of logs are called.
UPLOAD = "log-"


def path_of(folder: Path, client: str) -> Path:
    """Give the file of a client's state; its id is the digest of a key, never a client's own words."""
    return folder / f"{client}.state"


def sweep(folder: Path, keep: float) -> None:
    """Remove the states that are older than so many seconds, and what interrupted writers left."""
    for path in list(folder.iterdir()):
        is_ours = NAME.fullmatch(path.name) or (path.name.startswith(".") and ".state.tmp-" in path.name)
        with suppress(FileNotFoundError):
            if is_ours and path.stat().st_mtime < time() - keep:
                path.unlink()


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other services out of the folder, and remove logs that a killed one left.

    The folder is made where it is missing, for its owner alone.
    """
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        lock = (folder / "lock").open("a")
    except OSError as error:
        words = error.strerror or error
        msg = f"{folder}: the clients' states cannot be kept there ({words}); say --states OTHER-FOLDER"
        raise ConfigurationError(msg) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            msg = f"{folder}: another service keeps its states there; stop it, or say --states OTHER-FOLDER"
            raise ConfigurationError(msg) from None
        for left in folder.glob(f"{UPLOAD}*"):
            shutil.rmtree(left, ignore_errors=True)
        yield
