# SPDX-License-Identifier: BSD-3-Clause
"""Saved files taken apart and put together again with digests that fit, as an attacker would."""

import hashlib
import json

from magmatch.store import START


def apart(raw):
    """Metadata, entries of the arrays, content, and bytes of the arrays."""
    n = 8 + int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8:n])
    about = header.pop("__metadata__")
    del about["sha256"]
    return about, header, json.loads(about["content"]), raw[n:]


def together(about, header, content, data):
    """The file of these parts, whatever they are; content that is a word is JSON already."""
    words = content if isinstance(content, str) else json.dumps(content)
    about = {"data": hashlib.sha256(data).hexdigest(), "content": words} | {
        key: value for key, value in about.items() if key not in {"data", "content"}
    }
    parts = json.dumps(about)[1:], json.dumps(header).replace("{", ",", 1) if header else "}"
    return sealed(b'",' + "".join(parts).encode(), data)


def sealed(rest, data=b""):
    """The file of a header from behind its digest on."""
    head = START + hashlib.sha256(rest).hexdigest().encode() + rest
    return len(head).to_bytes(8, "little") + head + data
