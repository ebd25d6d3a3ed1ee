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
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
ROOMS = ("registration", "field", "preparation", "data/logs")
PACKAGE = Path("src/magmatch")
COMMAND = [sys.executable, "-m", "pytest", "-q", "-x"]
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
            for kind, text in variants(node, parent, lambda n: ast.get_source_segment(source, n), types):
                faulty = (line[:start] + text.encode() + line[end:]).decode()
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


def compiled_with(tree, path):
    """Files whose compiled code holds a file's: its own, and of all that import its loops, through others too."""
    stale, texts = {path}, {p: p.read_text() for p in tree.rglob("*.py")}
    found = {path} if "@njit" in texts[path] else set()
    while found:
        names = [".".join(p.relative_to(tree.parent).with_suffix("").parts) for p in found]
        found = {p for p, t in texts.items() if any(f"from {name} import" in t for name in names)} - stale
        stale |= found
    return stale


def tests_of(path):
    """The file's own tests, those of its sub-room, and those of its room, as far as there are any."""
    inner = Path(path).relative_to(PACKAGE)
    mirror = Path("tests") / inner.with_name(f"test_{inner.name}")
    return [str(t) for t in (mirror, *mirror.parents[:-2]) if (REPOSITORY / t).exists() and t != Path("tests/data")]


def run_tests(tree, tests, limit):
    """Outcome, and the first test that failed."""
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "OPENBLAS_NUM_THREADS": "1"}
    for test in tests:
        settings = {"cwd": tree, "env": environment, "timeout": limit, "text": True}
        try:
            done = subprocess.run([*COMMAND, test], **settings, capture_output=True, check=False)
        except subprocess.TimeoutExpired:
            return "timeout", test
        if done.returncode not in (0, 5):  # all passed, or there are none
            failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
            return "noticed", failed[0][:160] if failed else done.stdout[-160:]
    return "unnoticed", ""


def main():
    """Draw, plant, test, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument("--limit", type=float, default=600, help="seconds for a file or folder of tests")
    parser.add_argument("--out", type=Path, default="planted.jsonl")
    options = parser.parse_args()
    out = options.out
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
            for stale in compiled_with(tree / PACKAGE, tree / path):
                for compiled in (stale.parent / "__pycache__").glob(f"{stale.stem}.*"):
                    compiled.unlink()
            outcome, by = run_tests(tree, tests_of(path), options.limit)
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
