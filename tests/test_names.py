# SPDX-License-Identifier: BSD-3-Clause
"""One word has one meaning: no two classes share a name."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_no_two_classes_share_a_name():
    homes = defaultdict(set)
    for folder in ("src", "packages", "evaluation"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ClassDef):
                    homes[node.name].add(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert {name: sorted(where) for name, where in homes.items() if len(where) > 1} == {}
