# SPDX-License-Identifier: BSD-3-Clause
"""Put single-line faults into the arithmetic, one at a time, and see whether the tests of that stage notice.

By hand: ``python tests/plant_faults.py --n 60 --seed 1 --rooms registration preparation``. Faults are drawn at random
over function bodies; numbers that are settings (module and class level) are choices, not arithmetic, and are left
alone, as are messages. Results go to a file of JSON lines, and a run that was broken off goes on where it stood.
"""

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
ROOMS = ("registration", "field", "preparation", "data/logs")
PACKAGE = Path("src/magmatch")
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
TURNED = {ast.Lt: ">=", ast.LtE: ">", ast.Gt: "<=", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
# Where both sides may be equal, in words of the code; of measured numbers it never happens.
COUNTED = ("len(", "n_", "config.", "row", "count", "limit")
TWINS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any",
         "argmin": "argmax", "argmax": "argmin", "floor": "ceil"}  # fmt: skip
# Below and above, numbers guard against zero and overflow.
SMALLEST, LARGEST = 1e-8, 1e8
SKIPPED_CALLS = ("log", "log.info", "log.debug", "log.warning", "Verdict", "print", "ValueError", "Field")
SKIPPED_FUNCTIONS = ("__repr__", "__len__", "words", "_words")
ORDERED = {"cross", "arctan2", "subtract"}  # of two arguments of one type, elsewhere than here


def signatures(tree):
    """Types of the arguments of each function and class of ours, by name."""
    found = {}
    for path in tree.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                arguments = [a for a in node.args.args if a.arg not in ("self", "cls")]
                found[node.name] = [a.arg if a.annotation is None else ast.unparse(a.annotation) for a in arguments]
            elif isinstance(node, ast.ClassDef):
                fields = [f for f in node.body if isinstance(f, ast.AnnAssign)]
                found[node.name] = [ast.unparse(f.annotation) for f in fields]
    return found


def replaced(source, node, text):
    """The source with one node's text in place of another's; None where it spans several lines."""
    if node.lineno != node.end_lineno:
        return None
    lines = source.split("\n")
    line = lines[node.lineno - 1].encode()
    lines[node.lineno - 1] = (line[: node.col_offset] + text.encode() + line[node.end_col_offset :]).decode()
    return "\n".join(lines)


def variants(node, parent, source, types):
    """What a slip of the pen would make of a node: (kind, text)."""
    text = lambda n: ast.get_source_segment(source, n)  # noqa: E731
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield "operator", f"({text(node.left)} {OPERATORS[type(node.op)]} {text(node.right)})"
        if isinstance(node.op, ast.Add | ast.Sub):
            yield "dropped term", f"({text(node.left)})"
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in TURNED:
        left, right, turned = text(node.left), text(node.comparators[0]), TURNED[type(node.ops[0])]
        yield "comparison", f"({left} {turned} {right})"
        if turned[0] in "<>" and any(word in left + right for word in COUNTED):
            # The opposite of >= is <, of which <= differs in the limit alone.
            other = {">=": "<=", ">": "<", "<=": ">=", "<": ">"}[turned]
            yield "limit", f"({left} {other} {right})"
    elif isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in TWINS:
            yield "twin", text(node).replace(name, TWINS[name], 1)
        if name == "inv" and not node.args:
            yield "not inverted", text(node.func.value)
        known = ["array"] * len(node.args) if name in ORDERED else types.get(name, [])
        for k, (one, other) in enumerate(zip(node.args, node.args[1:], strict=False)):
            if k + 1 < len(known) and known[k] == known[k + 1] and text(one) != text(other):
                arguments = [text(a) for a in node.args]
                arguments[k : k + 2] = arguments[k + 1], arguments[k]
                keywords = [text(a) for a in node.keywords]
                yield "swapped arguments", f"{text(node.func)}({', '.join(arguments + keywords)})"
    elif isinstance(node, ast.Attribute) and node.attr == "T" and isinstance(node.ctx, ast.Load):
        yield "not transposed", text(node.value)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield "sign", f"({text(node.operand)})"
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "truth", str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        if isinstance(parent, ast.Subscript | ast.Slice | ast.Tuple) and isinstance(node.value, int):
            yield "index", str(node.value + 1)
        elif SMALLEST < abs(node.value) < LARGEST:
            yield "number", f"({2 * node.value!r})"
            yield "number", f"(-{node.value!r})"


def places(path, source, types):
    """All faults of one file: (line, kind, old line, new line)."""
    found, parents = [], {}
    tree = ast.parse(source)
    for node in ast.walk(tree):
        parents.update(dict.fromkeys(ast.iter_child_nodes(node), node))

    def visit(node, is_inside):
        if isinstance(node, ast.FunctionDef):
            if node.name in SKIPPED_FUNCTIONS:
                return
            for child in node.body:
                visit(child, True)
            return
        is_message = isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert | ast.AnnAssign) and not (
            isinstance(node, ast.AnnAssign) and node.value is not None and is_inside
        )
        if is_message or (isinstance(node, ast.Call) and ast.unparse(node.func) in SKIPPED_CALLS):
            return
        if is_inside:
            for kind, text in variants(node, parents.get(node), source, types):
                new = replaced(source, node, text)
                if new is not None:
                    found.append((node.lineno, kind, new))
        for child in ast.iter_child_nodes(node):
            if child is not getattr(node, "annotation", None):
                visit(child, is_inside)

    visit(tree, False)
    return [(str(path), line, kind, new) for line, kind, new in found]


def draw(n, seed, rooms):
    """So many faults, no two in one line, each file and each kind in it by how much arithmetic it holds."""
    types, all_places = signatures(REPOSITORY / PACKAGE), []
    for room in rooms:
        for path in sorted((REPOSITORY / PACKAGE / room).rglob("*.py")):
            all_places += places(path.relative_to(REPOSITORY), path.read_text(), types)
    random.Random(seed).shuffle(all_places)
    chosen = {}
    for place in all_places:
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
    """Outcome and the first test that failed."""
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "OPENBLAS_NUM_THREADS": "1"}
    end = time.monotonic() + limit
    for test in tests:
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-q", "-x", test], cwd=tree, env=environment, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True,
        )  # fmt: skip
        try:
            output = process.communicate(timeout=max(end - time.monotonic(), 1))[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return "timeout", test
        if process.returncode:
            failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
            return "noticed", failed[0][:160] if failed else output[-160:]
    return "unnoticed", ""


def main():
    """Draw, plant, test, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument(
        "--limit", type=float, default=600, help="seconds for the tests of one fault; then: unnoticed"
    )
    parser.add_argument("--out", type=Path, help="JSON lines; default: planted-SEED.jsonl in the temporary folder")
    options = parser.parse_args()
    out = options.out or Path(tempfile.gettempdir()) / f"planted-{options.seed}.jsonl"
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    done = {(row["path"], row["line"], row["kind"]) for row in rows}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        for path, line, kind, new in draw(options.n, options.seed, options.rooms):
            if (path, line, kind) in done:
                continue
            shutil.rmtree(tree, ignore_errors=True)
            # Times of files are kept, and with them what is compiled of all that does not change.
            for part in ("src", "tests", "pyproject.toml", "benchmarks"):
                source = REPOSITORY / part
                (shutil.copytree if source.is_dir() else shutil.copy2)(source, tree / part)
            old = (tree / path).read_text().splitlines()[line - 1]
            (tree / path).write_text(new)
            for stale in compiled_with(tree / PACKAGE, tree / path):
                for compiled in (stale.parent / "__pycache__").glob(f"{stale.stem}.*"):
                    compiled.unlink()
            start = time.monotonic()
            outcome, by = run_tests(tree, tests_of(path), options.limit)
            row = {"path": path, "line": line, "kind": kind, "old": old.strip(),
                   "new": new.splitlines()[line - 1].strip(), "outcome": outcome, "by": by,
                   "seconds": round(time.monotonic() - start)}  # fmt: skip
            rows.append(row)
            with out.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(f"{outcome:9} {path}:{line} {kind}\n  - {row['old']}\n  + {row['new']}\n  {by}", flush=True)
    counts = Counter(row["outcome"] for row in rows)
    print(f"{counts['noticed']} of {len(rows)} noticed ({counts['noticed'] / max(len(rows), 1):.0%}); {dict(counts)}")


if __name__ == "__main__":
    main()
