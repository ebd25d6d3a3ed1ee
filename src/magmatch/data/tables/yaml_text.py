# SPDX-License-Identifier: BSD-3-Clause
"""YAML from untrusted files: plain data only, with a bound on the number of values."""

from typing import Any

# Values of a document once all that it repeats by name is written out. Stated in docs/formats.md.
MAX_VALUES = 1_000_000


def load_yaml(text: str) -> Any:
    """Mappings, lists, words and numbers of a YAML document; tags run nothing, and `yaml.YAMLError` refuses bombs."""
    import yaml

    try:
        content = yaml.safe_load(text)
        weight = _weight(content, {})
    except RecursionError:
        msg = "nested too deeply"
        raise yaml.YAMLError(msg) from None
    if weight > MAX_VALUES:
        msg = f"repeats values by name to more than {MAX_VALUES}"
        raise yaml.YAMLError(msg)
    return content


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
