# SPDX-License-Identifier: BSD-3-Clause
"""Put single-line faults into the arithmetic, one at a time, and see whether the tests of that stage notice.

By hand: ``python tests/plant_faults.py --n 60 --seed 1 --rooms registration preparation``. Faults are drawn at random
over function bodies; numbers that are settings (module and class level) are choices, not arithmetic, and are left
alone, as are messages. A run that was broken off goes on where it stood.
"""

import argparse
import ast
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
ROOMS = ("registration", "estimation", "field", "preparation", "data/logs")
PACKAGE = Path("src/magmatch")
# The tests of `make test`.
COMMAND = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not slow"]
# What a file with compiled loops imports.
COMPILER = "magmatch.compiled"
# Address space of a run of tests.
MOST_BYTES = 12 * 1024**3
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
# The opposite of a comparison, and what differs from it in the limit alone.
TURNED = {ast.Lt: ">=", ast.LtE: ">", ast.Gt: "<=", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
AT_LIMIT = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}
# Where both sides may be equal, in words of the code; measured numbers never are.
COUNTED = ("len(", "n_", "config.", "row", "count", "limit")
TWINS = {"min": "max", "minimum": "maximum", "any": "all", "argmin": "argmax", "floor": "ceil"}
TWINS |= {other: one for one, other in TWINS.items()}
SMALLEST, LARGEST = 1e-8, 1e8  # beyond, numbers guard against zero and overflow
SKIPPED_CALLS = ("log.info", "log.debug", "log.warning", "Verdict", "print")


def signatures(tree):
    """Types of the arguments of each function and class of ours, by name."""
    found = {"cross": ["array"] * 2, "arctan2": ["array"] * 2}
    for path in tree.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                arguments = [a for a in node.args.args if a.arg not in ("self", "cls")]
                found[node.name] = [a.arg if a.annotation is None else ast.unparse(a.annotation) for a in arguments]
            elif isinstance(node, ast.ClassDef):
                found[node.name] = [ast.unparse(f.annotation) for f in node.body if isinstance(f, ast.AnnAssign)]
    return found


def variants(node, parent, text, types):
    """What a slip of the pen would make of a node: (kind, text)."""
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield "operator", f"({text(node.left)} {OPERATORS[type(node.op)]} {text(node.right)})"
        if isinstance(node.op, ast.Add | ast.Sub):
            yield "dropped term", f"({text(node.left)})"
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in TURNED:
        left, operator, right = text(node.left), type(node.ops[0]), text(node.comparators[0])
        yield "comparison", f"({left} {TURNED[operator]} {right})"
        if operator in AT_LIMIT and any(word in left + right for word in COUNTED):
            yield "limit", f"({left} {AT_LIMIT[operator]} {right})"
    elif isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in TWINS:
            yield "twin", text(node).replace(name, TWINS[name], 1)
        if name == "inv" and not node.args:
            yield "not inverted", text(node.func.value)
        known, arguments = types.get(name, []), [text(a) for a in node.args]
        for k in range(min(len(known), len(arguments)) - 1):
            if known[k] == known[k + 1] and arguments[k] != arguments[k + 1]:
                swapped = [*arguments[:k], arguments[k + 1], arguments[k], *arguments[k + 2 :]]
                yield (
                    "swapped arguments",
                    f"{text(node.func)}({', '.join(swapped + [text(a) for a in node.keywords])})",
                )
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield "not transposed", text(node.value)
    elif isinstance(node, ast.UnaryOp) and not isinstance(node.operand, ast.Constant):
        yield "sign", f"({text(node.operand)})"
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "truth", str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        is_shape = isinstance(parent, ast.Call) and text(parent.func).endswith("reshape")  # any negative side is open
        if isinstance(parent, ast.Subscript | ast.Slice | ast.Tuple) and isinstance(node.value, int):
            yield "index", str(node.value + 1)
        elif SMALLEST < abs(node.value) < LARGEST and not isinstance(parent, ast.UnaryOp) and not is_shape:
            yield "number", f"({2 * node.value!r})"
            yield "number", f"(-{node.value!r})"


def places(path, source, types):
    """All faults of one file: (path, line, kind, the file with the fault)."""
    lines, found = source.split("\n"), []

    def text(node):
        line = lines[node.lineno - 1].encode()
        if node.lineno == node.end_lineno:
            return line[node.col_offset : node.end_col_offset].decode()
        return ast.get_source_segment(source, node)  # slow

    def visit(node, parent, is_inside):
        if isinstance(node, ast.FunctionDef):
            if node.name not in ("__repr__", "words", "_words"):
                for child in node.body:
                    visit(child, node, True)
            return
        is_call = isinstance(node, ast.Call) and ast.unparse(node.func) in SKIPPED_CALLS
        if is_call or isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert):
            return
        if is_inside and isinstance(node, ast.expr) and node.lineno == node.end_lineno:
            line, start, end = lines[node.lineno - 1].encode(), node.col_offset, node.end_col_offset
            for kind, fault in variants(node, parent, text, types):
                faulty = (line[:start] + fault.encode() + line[end:]).decode()
                new = "\n".join([*lines[: node.lineno - 1], faulty, *lines[node.lineno :]])
                found.append((str(path), node.lineno, kind, new))
        for child in ast.iter_child_nodes(node):
            if child is not getattr(node, "annotation", None):
                visit(child, node, is_inside)

    visit(ast.parse(source), None, False)
    return found


def draw(n, seed, rooms):
    """So many faults, no two in one line."""
    types, everywhere, chosen = signatures(REPOSITORY / PACKAGE), [], {}
    for room in rooms:
        for path in sorted((REPOSITORY / PACKAGE / room).rglob("*.py")):
            everywhere += places(path.relative_to(REPOSITORY), path.read_text(), types)
    random.Random(seed).shuffle(everywhere)
    for place in everywhere:
        chosen.setdefault(place[:2], place)
    return list(chosen.values())[:n]


class Imports:
    """Which files of the package and of its tests import which."""

    def __init__(self):
        self.module = {}
        for folder, root in ((PACKAGE, PACKAGE.parent), (Path("tests"), Path("tests"))):
            for path in sorted((REPOSITORY / folder).rglob("*.py")):
                inner = path.relative_to(REPOSITORY / root).with_suffix("")
                self.module[path.relative_to(REPOSITORY)] = ".".join(inner.parts).removesuffix(".__init__")
        self.uses = {path: set(_imported(REPOSITORY / path)) for path in self.module}
        for path in self.tests():
            # What the fixtures of its folders use.
            self.uses[path] |= {".".join((*folder.parts[1:], "conftest")) for folder in path.parents[:-1]}

    def tests(self):
        """Files that hold tests."""
        return [path for path in self.module if path.name.startswith("test_")]

    def rings(self, path, user_of=None):
        """A file, those that import it, those that import one of these, and so on; all of them users of a module."""
        ring, seen = {path}, {path}
        while ring:
            yield ring
            names = {self.module[p] for p in ring}
            ring = {p for p, used in self.uses.items() if names & used and user_of in (None, *used)} - seen
            seen |= ring

    def compiled_with(self, path):
        """Files whose compiled code holds a file's: its own, and of all that call its loops, through others too."""
        return set().union(*self.rings(path, COMPILER)) if COMPILER in self.uses[path] else {path}

    def tests_of(self, path, most):
        """A file's own tests, then those that the fewest imports lead to; of these first those of its own rooms."""
        mirror, ranks = Path("tests") / path.relative_to(PACKAGE).with_name(f"test_{path.name}"), {}
        for n_imports, ring in enumerate(self.rings(path)):
            for test in ring.intersection(self.tests()):
                n_shared = sum(one == other for one, other in zip(test.parts, mirror.parts, strict=False))
                ranks[test] = (test != mirror, n_imports, -n_shared, str(test))
        return sorted(ranks, key=ranks.__getitem__)[:most]


def _imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from (node.module, *(f"{node.module}.{name.name}" for name in node.names))


def _bounded():
    """A fault must not take all memory of the machine."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


def run_tests(tree, tests, limit):
    """Outcome, and the first test that failed; tests that hang say less on a busy machine: then give more time."""
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "OPENBLAS_NUM_THREADS": "1"}
    command = [*COMMAND, "-o", f"faulthandler_timeout={limit}", "-o", "faulthandler_exit_on_timeout=true", *tests]
    done = subprocess.run(
        command, cwd=tree, env=environment, text=True, capture_output=True, check=False, preexec_fn=_bounded
    )
    if done.returncode == 0:
        return "unnoticed", ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return ("noticed", failed[0][:160]) if failed else ("hung", (done.stdout + done.stderr)[-160:])


def main():
    """Draw, plant, test, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument("--n-files", type=int, default=8, help="files of tests that may notice a fault")
    parser.add_argument("--limit", type=float, default=300, help="seconds after which a test hangs")
    parser.add_argument("--out", type=Path, default="planted.jsonl")
    options = parser.parse_args()
    out, imports = options.out, Imports()
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    done = {(row["path"], row["line"]) for row in rows}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        faults = draw(options.n, options.seed, options.rooms)
        for path, line, kind, new in (fault for fault in faults if fault[:2] not in done):
            shutil.rmtree(tree, ignore_errors=True)
            # Times of files are kept, and with them what is compiled of all that does not change.
            for part in ("src", "tests", "benchmarks"):
                shutil.copytree(REPOSITORY / part, tree / part)
            shutil.copy2(REPOSITORY / "pyproject.toml", tree)
            (tree / path).write_text(new)
            for stale in imports.compiled_with(Path(path)):
                for compiled in (tree / stale.parent / "__pycache__").glob(f"{stale.stem}.*"):
                    compiled.unlink()
            outcome, by = run_tests(tree, imports.tests_of(Path(path), options.n_files), options.limit)
            old, fault = ((root / path).read_text().splitlines()[line - 1].strip() for root in (REPOSITORY, tree))
            rows.append(
                {"path": path, "line": line, "kind": kind, "old": old, "new": fault, "outcome": outcome, "by": by}
            )
            out.write_text("".join(json.dumps(row) + "\n" for row in rows))
            print(f"{outcome:9} {path}:{line} {kind}\n  - {old}\n  + {fault}\n  {by}", flush=True)
    counts = Counter(row["outcome"] for row in rows)
    print(f"{counts['noticed']} of {len(rows)} noticed ({counts['noticed'] / max(len(rows), 1):.0%}); {dict(counts)}")


if __name__ == "__main__":
    main()
