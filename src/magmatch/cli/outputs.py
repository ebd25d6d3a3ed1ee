# SPDX-License-Identifier: BSD-3-Clause
"""Output paths: checked before the work begins."""

import json
import tempfile
from collections.abc import Iterable
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmatch.atomic import real_path
from magmatch.cli.boundary import DONE, NOT_ACCEPTED
from magmatch.cli.narration import put, say
from magmatch.errors import ConfigurationError, DataFormatError

if TYPE_CHECKING:
    from magmatch.data.document import TypedDocument


def check_outputs(
    outputs: Iterable[Path | None],
    inputs: Iterable[Path | None] = (),
    *,
    page: Path | None = None,
    recording: Path | None = None,
) -> None:
    """Make sure that results, a page and a recording for Rerun can be made, before any work is done."""
    if page is not None and page.suffix.lower() not in ("", ".html", ".htm"):
        msg = f"{page}: a page is HTML, expected a name that ends in .html"
        raise ConfigurationError(msg)
    taken = {real_path(path): "an input" for path in inputs if path is not None}
    for path in (*outputs, page, recording):
        if path is None:
            continue
        place = real_path(path)
        if place in taken:
            msg = f"{path}: would overwrite {taken[place]}; give it another name"
            raise ConfigurationError(msg)
        if path.is_dir():
            raise DataFormatError(path, "is a folder, expected the name of a file to write")
        if place.is_file() or not path.exists():
            _try_to_write(place.parent, path)
        if not place.exists() or place.is_file():  # two results may share a device such as /dev/stdout
            taken[place] = "another result"
    if page is not None:
        from magmatch.viz.figures.draw import require_plotly

        require_plotly()
    if recording is not None:
        from magmatch.viz.rerun_recording import require_rerun

        require_rerun()


def check_folder(path: Path) -> None:
    """Make sure that a folder for results exists or can be created (its parent must exist), without creating it."""
    if path.exists() and not path.is_dir():
        raise DataFormatError(path, "is a file, expected the name of a folder to write to")
    _try_to_write(path if path.is_dir() else real_path(path).parent, path)


def free_name(stem: str, suffix: str) -> Path:
    """Name in this folder for what the user did not name: with a number behind it where there is such a file."""
    numbered = (f"{stem}-{n}{suffix}" for n in count(2))
    return next(path for path in map(Path, chain([stem + suffix], numbered)) if not path.exists())


def answer(result: "TypedDocument", words: str, *, is_good: bool, json: bool) -> int:
    """Print a result, as JSON too where asked for; gives the exit code."""
    if json:
        put(as_json(result.to_dict()))
    say(words)
    return DONE if is_good else NOT_ACCEPTED


def as_json(content: dict[str, Any]) -> str:
    """Format content as indented JSON; NaN is an error."""
    return json.dumps(content, indent=2, allow_nan=False)


def _try_to_write(folder: Path, path: Path) -> None:
    """Create and delete a file: only this finds missing permissions, read-only disks and odd file systems alike."""
    if not folder.is_dir():
        raise DataFormatError(path, f"the folder {folder} does not exist; create it first")
    try:
        with tempfile.NamedTemporaryFile(prefix=".magmatch-", dir=folder):
            pass
    except PermissionError:
        raise DataFormatError(path, f"no permission to write in the folder {folder}") from None
    except OSError as error:  # which names the file that was tried
        raise OSError(error.errno, error.strerror, str(path)) from None
