# SPDX-License-Identifier: BSD-3-Clause
"""What the scripts in ``benchmarks/`` share: arguments, clocks, errors, kept rows, processes of their own.

Only NumPy is imported before it is needed: some scripts measure what a process takes that imports nothing else.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from magmatch.registration.result import RegistrationResult

T = TypeVar("T")
UT = 1e-6
# What rows may depend on.
CODE = ("src", "packages/magmatch-evaluation/src", "benchmarks/*.py")
# Folder of public recordings beside the checkout; None, the cache, where there is none.
RECORDINGS = next(filter(Path.is_dir, [Path("../shared/data")]), None)


def arguments(doc: str | None, words: Sequence[str] | None = None, **defaults: Any) -> argparse.Namespace:
    """Read the command line: free words, if any are named, and an option for each default or type.

    A default of False makes a switch, a list an option of several words, a function one whose word it is given
    (`saved_table.saver`); ``recordings`` is a folder, ``--from``.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if words is not None:
        parser.add_argument("words", nargs="*", default=list(words))
    for name, default in defaults.items():
        flag = "--from" if name == "recordings" else "--" + name.replace("_", "-")
        how: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            how = {"action": "store_true"}
        elif isinstance(default, list):
            how = {"nargs": "+", "type": type(default[0]) if default else str, "default": default}
        elif name == "recordings":
            how = {"type": Path, "default": RECORDINGS}
        elif callable(default):
            how = {"type": default}
        parser.add_argument(flag, dest=name, **how)
    return parser.parse_args()


class Timed(NamedTuple, Generic[T]):
    """What a call returned, and its seconds of the clock and of the processor."""

    value: T
    clock: float
    processor: float


def timed(function: Callable[..., T], *args: Any, **kwargs: Any) -> Timed[T]:
    """Call a function and take its time."""
    clock, processor = time.perf_counter(), time.process_time()
    value = function(*args, **kwargs)
    return Timed(value, time.perf_counter() - clock, time.process_time() - processor)


def rmse_ut(field: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square error of 3-vectors, uT."""
    return float(np.sqrt(((field - truth) ** 2).sum(axis=1).mean())) / UT


def pose_error(result: "RegistrationResult", T_true: "RigidTransform", center: np.ndarray) -> tuple[float, float]:
    """Error of the best pose, accepted or not, at a point: m and rad; inf where there is none."""
    if result.best_pose is None:
        return np.inf, np.inf
    from magmatch.geometry import transform_error

    return transform_error(result.best_pose, T_true, center)


def kept(
    path: Path,
    names: Iterable[str],
    make: Callable[[str], dict[str, Any]],
    *,
    jobs: int = 1,
    minutes: float = np.inf,
) -> dict[str, dict[str, Any]]:
    """Rows of all names, in a file of JSON lines, whose folder is made: those that it holds are not made again.

    Each notes the commit it was made of; None where the code has changed since.
    """
    from magmatch_evaluation.parallel import run_all
    from magmatch_evaluation.saved_table import clean_commit

    path.parent.mkdir(parents=True, exist_ok=True)
    known = {r["name"]: r for r in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    wanted, end = list(names), time.monotonic() + 60 * minutes
    try:
        commit = clean_commit(CODE)
    except (argparse.ArgumentTypeError, OSError, subprocess.CalledProcessError):
        commit = None
    todo = takewhile(lambda _: time.monotonic() < end, [name for name in wanted if name not in known])
    with path.open("a") as stream:
        for name, row in run_all(make, todo, jobs):
            known[name] = {"name": name} | row | {"commit": commit}
            stream.write(json.dumps(known[name]) + "\n")
            stream.flush()
    return {name: known[name] for name in wanted if name in known}


def in_groups(groups: Iterable[str], rows: Mapping[str, dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Each group that has rows, and those: of `kept` rows whose names begin with the group's words."""
    found = ((group, [row for name, row in rows.items() if name.startswith(f"{group} ")]) for group in groups)
    return [(group, some) for group, some in found if some]


def alone(script: str, *words: object) -> Any:
    """Run a script in a process of its own; show what it prints, but for the last line, JSON, which is returned."""
    out = subprocess.run([sys.executable, script, *map(str, words)], check=True, stdout=subprocess.PIPE, text=True)
    *lines, last = out.stdout.splitlines()
    if lines:
        sys.stdout.write("\n".join(lines) + "\n")
    return json.loads(last)


def peak_mib() -> float:
    """Largest resident memory of this process so far."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
