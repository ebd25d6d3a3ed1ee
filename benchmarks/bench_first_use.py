# SPDX-License-Identifier: BSD-3-Clause
"""How long a newcomer waits: the first registration on a machine against later ones, as ratios.

    python benchmarks/bench_first_use.py [--rounds 3]

The first is one with an empty compilation cache (a temporary NUMBA_CACHE_DIR). Wall seconds of whole processes, and
CPU seconds of theirs and their helpers', which depend less on what else the machine does; medians of n rounds.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from importlib.resources import as_file, files
from pathlib import Path
from statistics import median

from magmatch_evaluation.script import arguments


def register(base: Path, target: Path, folder: Path) -> tuple[float, float, float]:
    """Wall and CPU seconds of one registration by the command line, and the seconds that it states."""
    words = [sys.executable, "-m", "magmatch", "register", str(base), str(target), "--out", str(folder / "r.json")]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, env={**os.environ, "NUMBA_CACHE_DIR": str(folder)}, capture_output=True, check=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, cpu, json.loads((folder / "r.json").read_text())["seconds"]["total"]


def main() -> None:
    # Empty caches; three later registrations follow each.
    n = arguments(__doc__, rounds=3).rounds
    first, later = [], []
    with as_file(files("magmatch.data") / "samples" / "office") as office:
        for _ in range(n):
            with tempfile.TemporaryDirectory() as folder:
                runs = [register(office / "base.csv", office / "target.csv", Path(folder)) for _ in range(4)]
            first.append(runs[0])
            later += runs[1:]
    (wall_1, cpu_1, _), (wall, cpu, _) = (tuple(map(median, zip(*runs, strict=True))) for runs in (first, later))
    unstated = median((w - stated) / w for w, _, stated in later)
    print(f"first registration (n = {n}): {wall_1:.2f} s wall, {cpu_1:.2f} s CPU")
    print(f"later registration (n = {3 * n}): {wall:.2f} s wall, {cpu:.2f} s CPU")
    print(f"first over later: {wall_1 / wall:.2f} wall, {cpu_1 / cpu:.2f} CPU; at most 3")
    print(f"wall time that is not in the stated total, later runs: {unstated:.0%}; at most 20%")


if __name__ == "__main__":
    main()
