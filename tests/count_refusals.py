# SPDX-License-Identifier: BSD-3-Clause
"""Count what is refused in the tests: bad calls, options and files, each with one sentence and no traceback.

Run: python tests/count_refusals.py. It runs these tests (three minutes) and prints a table.
"""

import os
import re
import sys
from collections import Counter
from pathlib import Path

import pytest

HERE = Path(__file__).parent
GROUPS = {
    "calls in Python": ["test_python_door.py"],
    "commands, options, settings": ["cli/test_bad_input.py"],
    "tables, phones, archives": ["data/formats", "data/tables", "data"],
    "ROS and MCAP logs": ["data/logs"],
    "saved maps and records": ["field/test_crafted_maps.py", "hardening/test_fuzz_records.py"],
}
# Names of tests are claims; these words claim that something bad is answered.
BAD = re.compile(r"refused|named|fault|damage|known_error|says_wh|names_the|one_line|is_said|bad_|cannot_be")


class Count:
    """Counts cases and those that Hypothesis or the fuzzer draws, and what did not pass."""

    def __init__(self) -> None:
        self.cases: Counter[str] = Counter()
        self.drawn: Counter[str] = Counter()
        self.failed: list[str] = []

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if BAD.search(item.name)]
        for item in items:
            group = group_of(Path(item.fspath).relative_to(HERE).as_posix())
            drawn = getattr(item.obj, "_hypothesis_internal_use_settings", None)
            self.cases[group] += drawn is None
            self.drawn[group] += 0 if drawn is None else drawn.max_examples

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)


def group_of(path: str) -> str:
    """The group with the longest beginning that fits."""
    fits = [(len(start), name) for name, starts in GROUPS.items() for start in starts if path.startswith(start)]
    return max(fits)[1]


def main() -> None:
    count = Count()
    sys.path.insert(0, str(HERE))
    os.chdir(HERE.parent)
    code = pytest.main(
        ["-q", *(str(HERE / start) for starts in GROUPS.values() for start in starts)], plugins=[count]
    )
    print("| what | cases by hand | drawn at random |\n| --- | --- | --- |")
    for group in GROUPS:
        print(f"| {group} | {count.cases[group]} | {count.drawn[group] or ''} |")
    print(
        f"\n{sum(count.cases.values())} and {sum(count.drawn.values())}; {len(count.failed)} not answered as claimed"
    )
    sys.exit(code)


if __name__ == "__main__":
    main()
