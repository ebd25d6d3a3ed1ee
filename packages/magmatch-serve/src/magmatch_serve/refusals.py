# SPDX-License-Identifier: BSD-3-Clause
"""A refusal is a status code of HTTP and one sentence. A WebSocket is closed with 4000 more."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

CLOSE_WITH = 4000


class RefusedError(Exception):
    """Told to whoever asked; nothing of this machine is in its words."""

    def __init__(self, status: int, message: str, retry_after: float | None = None) -> None:
        # All of it, so that it comes whole out of another process.
        super().__init__(status, message, retry_after)
        self.status, self.message, self.retry_after = status, " ".join(message.split()), retry_after

    def __str__(self) -> str:
        return self.message

    @property
    def document(self) -> dict[str, Any]:
        """Describe it as JSON."""
        return {"type": "error", "status": self.status, "message": self.message}

    @property
    def headers(self) -> dict[str, str]:
        """Headers that say when to come again, and how to say who one is."""
        found = {} if self.retry_after is None else {"Retry-After": str(max(1, round(self.retry_after)))}
        return found | ({"WWW-Authenticate": "Bearer"} if self.status == 401 else {})


def or_raised(found: Any) -> Any:
    """An answer of another process; a refusal is raised."""
    if isinstance(found, RefusedError):
        raise found
    return found


def without_paths(words: str, names: Mapping[Path, str]) -> str:
    """Say on one line what is said of files, by names instead of their paths, whether these are absolute or not."""
    words = " ".join(words.split())
    for path, name in names.items():
        for form in {str(path), str(path.resolve())} - {".", "/"}:
            words = words.replace(form, name)
    return words
