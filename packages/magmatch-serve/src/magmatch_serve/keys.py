# SPDX-License-Identifier: BSD-3-Clause
"""A client is a secret key, which alone opens its state, and an id made of it that may be seen by all."""

import hashlib
import re
import secrets

KEY = re.compile(r"[A-Za-z0-9_-]{43}")


def new_key() -> str:
    """Draw 256 bits."""
    return secrets.token_urlsafe(32)


def is_key(text: str) -> bool:
    """Say whether this can be a key."""
    return KEY.fullmatch(text) is not None


def id_of(key: str) -> str:
    """Name a client in files and pictures; its key does not follow from it."""
    return hashlib.sha256(key.encode()).hexdigest()[:24]
