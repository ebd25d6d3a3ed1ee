# SPDX-License-Identifier: BSD-3-Clause
"""Classes of settings have a table of them on the page of the API: the comments of their fields, parts included."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from pkgutil import resolve_name
from typing import Any

import griffe

from magmatch.settings import Settings

HEAD = "| setting | type | default | meaning |\n|---|---|---|---|\n"


class SettingsTables(griffe.Extension):
    """Adds the table to the text of each class."""

    def on_class_instance(self, *, cls: griffe.Class, **_: Any) -> None:
        """Called for each class that is read."""
        if cls.docstring is not None and any(str(base) == "Settings" for base in cls.bases):
            lines = ("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows(cls.path))
            cls.docstring.value += "\n\n" + HEAD + "\n".join(lines)


def rows(path: str, prefix: str = "") -> Iterator[tuple[str, str, str, str]]:
    """Name, type, default and meaning of each setting of a class."""
    kind = resolve_name(path)
    said = comments(kind)
    for name, field in kind.model_fields.items():
        part = field.annotation
        if isinstance(part, type) and issubclass(part, Settings):
            yield f"`{prefix}{name}`", "", "", inspect.getdoc(part).splitlines()[0]
            yield from rows(f"{part.__module__}.{part.__qualname__}", f"{prefix}{name}.")
        else:
            words = part.__name__ if isinstance(part, type) else re.sub(r"\b(typing|pathlib)\.", "", str(part))
            default = field.get_default(call_default_factory=True)
            yield f"`{prefix}{name}`", f"`{words}`", f"`{default!r}`", field.description or said.get(name, "")


def comments(kind: type) -> dict[str, str]:
    """What stands above and beside each field; one comment may hold for several in a row."""
    source = textwrap.dedent(inspect.getsource(kind))
    lines, found, last = source.splitlines(), {}, ""
    for field in ast.parse(source).body[0].body:
        if not isinstance(field, ast.AnnAssign):
            last = ""
            continue
        first, end = field.lineno - 1, field.end_lineno - 1
        above = first
        while lines[above - 1].strip().startswith("#"):
            above -= 1
        last = " ".join(line.strip(" #") for line in lines[above:first]) or last
        beside = re.sub(r"noqa.*", "", lines[end][field.end_col_offset :].strip(" #"))
        found[field.target.id] = f"{last} ({beside})" if last and beside else last or beside
    return found
