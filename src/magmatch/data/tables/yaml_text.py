# SPDX-License-Identifier: BSD-3-Clause
"""YAML from untrusted files: plain data only, with a bound on the number of values."""

from pathlib import Path
from typing import Any

from magmatch.data.tables.text import text_lines
from magmatch.errors import DataFormatError

# Values of a document once all that it repeats by name is written out. Stated in docs/formats.md.
MAX_VALUES = 1_000_000


def read_yaml(path: str | Path, raw: bytes, advice: str = "") -> Any:
    """Mappings, lists, words and numbers of a YAML file, from its bytes; tags run nothing, and bombs are refused."""
    import yaml

    lines, line = text_lines(path, raw), None
    try:
        content = yaml.safe_load("\n".join(lines))
        if _weight(content, {}) <= MAX_VALUES:
            return content
        words = f"repeats values by name to more than {MAX_VALUES}"
    except RecursionError:
        words = "nested too deeply"
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        words = str(error.problem or error.context)
    except (yaml.YAMLError, ValueError) as error:
        words = " ".join(str(error).split())[:200]
    raise DataFormatError(path, f"is not YAML: {words}{advice}", line=line)


def mapping_in(content: Any) -> dict[Any, Any]:
    """What a document of YAML or JSON holds by name: nothing where it is a list, a word or a number."""
    return content if isinstance(content, dict) else {}


def _weight(value: Any, known: dict[int, float]) -> float:
    """Values in a document, those that stand at several places counted at each; infinite where one holds itself."""
    if not isinstance(value, dict | list | set | tuple):
        return 1.0
    if id(value) not in known:
        known[id(value)] = float("inf")  # until all it holds has been counted
        parts = [part for pair in value.items() for part in pair] if isinstance(value, dict) else list(value)
        known[id(value)] = 1.0 + sum(_weight(part, known) for part in parts)
    return known[id(value)]
