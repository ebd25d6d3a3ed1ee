# SPDX-License-Identifier: BSD-3-Clause
"""Mutate, damage, kill and fill disks as the suite does, some hundred times each, and count what failed.

    python benchmarks/faults.py [--fuzz 200] [--kills 190] [--corruptions 2000] [--save faults]

About five minutes on one core. The suite's own tests do the work; a test ends at its first failure.
"""

import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from magmatch_evaluation.saved_table import saver, show
from magmatch_evaluation.script import arguments

COLUMNS = ("what goes wrong", "what must hold", "tried", "tests failed")
READ = "read, or refused in one line, within 20 s and 700 MiB"
SAME = "goes on, and ends in the same bits"
FILES, DAMAGED = "{n} files, {fuzz:,} times each", "{n} files, {corruptions:,} times each"
# By the name of the test, without "test_": what goes wrong, what must hold, and what was tried of n cases.
ROWS = {
    "mutated_files_end_in_a_survey_or_a_known_error": ("logs and tables are mutated", READ, FILES),
    "mutated_trajectories_end_in_poses_or_a_known_error": ("trajectories are mutated", "read, or refused", FILES),
    "mutated_records_end_in_themselves_or_a_known_error": ("saved files are mutated, checksums fit", READ, FILES),
    "damage_never_reads_back_as_something_else": ("results are damaged", "refused, or read as they were", DAMAGED),
    "a_killed_writer_leaves_one_whole_file": (
        "writers are killed",
        "the old file or the new, whole",
        "{kills:,} kills",
    ),
    "a_killed_run_goes_on_and_gives_the_same_bits": ("slam is killed", SAME, "2 kills"),
    "a_killed_merge_goes_on_with_the_pairs_that_are_missing": ("merge is killed", SAME, "1 kill"),
    "a_disk_that_fails_is_named_and_the_old_file_stays": (
        "the disk is full or fails, in eight ways",
        "the old file, and a line that names it",
        "{n} cases",
    ),
}


def of(test: ElementTree.Element) -> str:
    """Name of a test's function, as in `ROWS`."""
    return test.attrib["name"].split("[")[0].removeprefix("test_")


def main() -> int:
    asked = arguments(__doc__, fuzz=200, kills=190, corruptions=2000, save=saver)
    counts = {name: getattr(asked, name) for name in ("fuzz", "kills", "corruptions")}
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        options = [f"--{name}={count}" for name, count in counts.items()]
        # In a process of its own a test that crashes is one that failed, and the others go on.
        words = ["pytest", "-q", "-n", "1", "-k", " or ".join(ROWS), *options, f"--junit-xml={report}"]
        subprocess.run([sys.executable, "-m", *words, "tests/hardening", "tests/data/logs/test_fuzz.py"], check=False)
        tests = ElementTree.parse(report).getroot().findall(".//testcase")
    run = [test for test in tests if test.find("skipped") is None]
    n = Counter(map(of, run))
    failed = Counter(of(test) for test in run if test.find("failure") is not None or test.find("error") is not None)
    rows = [
        (what, holds, tried.format(n=n[name], **counts), failed[name]) for name, (what, holds, tried) in ROWS.items()
    ]
    show(COLUMNS, rows, asked.save)
    return 0


if __name__ == "__main__":
    sys.exit(main())
