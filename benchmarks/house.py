# SPDX-License-Identifier: BSD-3-Clause
"""Figures of the house: lines, files, settings, names, pages, contracts, and how deep the search lies.

    python benchmarks/house.py [CHECKOUT] [CHECKOUT]

Lines are of all Python in a checkout but the tests, whose own stand below for comparison: of code, of docstring, of
comment alone, and all. Settings are the fields of all classes of settings that are no settings themselves, and of
them the leaves of `RegistrationConfig`; numbers are all that somebody chose or fitted there, constants too.
The depth is the number of calls from `register` to the first step of the search, `register` not counted. With two
checkouts: before and after.
"""

import ast
import io
import json
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).resolve()
# The file of each room that reads as its algorithm, wherever it lies.
VERBS = (
    "benchmark.py", "build.py", "compare.py", "extract.py", "localize.py", "map_strategy.py", "method.py",
    "prepare.py", "register.py", "register_map.py", "register_walk.py", "run.py", "simulate.py", "walk_strategy.py",
)  # fmt: skip
# What registration/search holds, by the names that its files had before that folder was made.
STEPS = ("annealing", "candidate", "invariant_search", "neighbours", "pair_search", "scoring")
# Where packages lie.
PACKAGES = ("src", "packages")
# Assigned, but chosen by nobody: an axis, quantiles of distributions (their probabilities are counted where chosen).
NOT_CHOSEN = {"UP", "MEDIAN_CHI2_3", "MEDIAN_CHI2_5", "FAR2"}
# Inside functions, these are of mathematics: halves, doubles, squares, dimensions.
PLAIN = {0.0, 0.5, 1.0, 1.5, 2.0, 3.0}
LINE_KINDS = ("code", "docstring", "comment", "all")


def files_of(root: Path, ending: str = ".py") -> list[Path]:
    """Files that git knows or would add, from the root."""
    words = ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()
    return sorted(Path(name) for name in names if name.endswith(ending) and (root / name).is_file())


def count_lines(path: Path) -> Counter[str]:
    """Lines of a file by kind; a line of code with a comment is code."""
    source, docstrings, code, comments = path.read_text(encoding="utf-8"), set(), set(), set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body and ast.get_docstring(node, clean=False) is not None else None
            docstrings |= set(range(first.lineno, first.end_lineno + 1)) if first else set()
    silent = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.type not in silent:
            code |= set(range(token.start[0], token.end[0] + 1))
    code -= docstrings
    sizes = (len(code), len(docstrings), len(comments - code), len(source.splitlines()))
    return Counter(dict(zip(LINE_KINDS, sizes, strict=True)))


def room_of(path: Path) -> str:
    """Folder under which the lines of a file are added up: a room of the package, or a folder at the top."""
    if "tests" in path.parts:
        return "tests"
    depth = 3 if path.parts[0] == "src" and len(path.parts) > 3 else 2 if path.parts[0] == "src" else 1
    return "/".join(path.parts[:depth])


def lines(root: Path) -> dict[str, Counter[str]]:
    """Lines by room, with the number of files."""
    rooms: dict[str, Counter[str]] = {}
    for path in files_of(root):
        rooms.setdefault(room_of(path), Counter()).update(count_lines(root / path) + Counter(files=1))
    return dict(sorted(rooms.items()))


def verb_pages(root: Path) -> dict[str, int]:
    """Lines of the files that read as an algorithm, the longest first."""
    pages = {
        path.as_posix(): len((root / path).read_text(encoding="utf-8").splitlines())
        for path in files_of(root)
        if path.name in VERBS and path.parts[0] in PACKAGES and "cli" not in path.parts
    }
    return dict(sorted(pages.items(), key=lambda item: -item[1]))


def largest_folders(root: Path) -> list[tuple[str, int]]:
    """Folders with the most files of their own, ``__init__`` not counted."""
    counts = Counter(
        path.parent.as_posix() for path in files_of(root) if "tests" not in path.parts and path.name != "__init__.py"
    )
    return counts.most_common(6)


def public_names(root: Path) -> int:
    """Functions and classes of all modules outside the tests whose names do not begin with an underscore."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    modules = (
        ast.parse((root / path).read_text(encoding="utf-8")) for path in files_of(root) if path.parts[0] in PACKAGES
    )
    return sum(isinstance(n, kinds) and not n.name.startswith("_") for module in modules for n in module.body)


def contracts(root: Path) -> int:
    """Contracts of imports."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    return len(settings["tool"]["importlinter"]["contracts"])


def asked_inside(root: Path, question: str) -> object:
    """Let another process, which imports the package of that checkout, answer a question about it."""
    program = f"import sys; sys.path[:0] = [{str(root / 'src')!r}, {str(HERE.parent)!r}]; import house, json"
    program += f"; print(json.dumps(house.{question}()))"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=root)
    return json.loads(done.stdout.splitlines()[-1])


def all_settings() -> int:
    """Fields of all classes of settings in the package that is imported, those that hold other settings left out."""
    import pkgutil
    from importlib import import_module

    import magmatch
    from magmatch.settings import Settings

    for module in pkgutil.walk_packages(magmatch.__path__, "magmatch."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    kinds, found = [Settings], set()
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        own = (
            (name, kind.model_fields[name].annotation) for name in kind.__annotations__ if name in kind.model_fields
        )
        found |= {(kind, name) for name, of in own if not (isinstance(of, type) and issubclass(of, Settings))}
    return len(found)


def asked_kinds(root: Path) -> int:
    """Calls of `isinstance` in the package."""
    nodes = (node for path in (root / "src").rglob("*.py") for node in ast.walk(ast.parse(path.read_text("utf-8"))))
    return sum(isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance" for node in nodes)


def named_numbers(root: Path) -> int:
    """Names in capitals that modules of the package give to numbers, or to what holds one."""
    count = 0
    for path in (root / "src").rglob("*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                has_number = any(type(getattr(n, "value", None)) in (int, float) for n in walk_outside(node.value))
                count += has_number * sum(name.isupper() for name in names_of(node))
    return count


def settings() -> int:
    """Leaves of the configuration of registration, in the package that is imported."""
    from pydantic import BaseModel

    from magmatch.registration.config import RegistrationConfig

    def models_in(annotation: object) -> Iterator[type[BaseModel]]:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            yield annotation
        for part in getattr(annotation, "__args__", ()):
            yield from models_in(part)

    def leaves(model: type[BaseModel]) -> int:
        inner = [list(models_in(field.annotation)) for field in model.model_fields.values()]
        return sum(sum(map(leaves, models)) if models else 1 for models in inner)

    return leaves(RegistrationConfig)


def numbers(root: Path) -> int:
    """Numbers that somebody chose in registration, and in what it estimates by.

    Defaults of settings, what is assigned in modules and classes.

    Those that were fitted count too; the published method and the format of results do not, nor does 0, which means
    none, nor what `NOT_CHOSEN` names.
    """
    return sum(numbers_by_file(root).values())


def numbers_by_file(root: Path) -> Counter[str]:
    """`numbers` of each file, by its name."""
    rooms = [root / "src/magmatch" / name for name in ("registration", "estimation")]
    fitted = [json.loads(path.read_text(encoding="utf-8")) for room in rooms for path in room.rglob("fitted.json")]
    count = Counter({"fitted": sum(len(law["offset"]) + ("scale" in law) + ("saturation" in law) for law in fitted)})
    for path in (path for room in rooms for path in room.rglob("*.py")):
        if path.parent.name == "published" or path.name in ("result.py", "mapped_arrays.py"):
            continue
        module = ast.parse(path.read_text(encoding="utf-8"))
        bodies = [module.body, *(node.body for node in module.body if isinstance(node, ast.ClassDef))]
        for node in (node for body in bodies for node in body if isinstance(node, ast.Assign | ast.AnnAssign)):
            value = None if names_of(node) & NOT_CHOSEN else node.value
            if isinstance(value, ast.Call) and getattr(value.func, "id", "") == "Field":
                value = next((word.value for word in value.keywords if word.arg == "default"), None)
            found = [] if value is None else [n.value for n in walk_outside(value) if isinstance(n, ast.Constant)]
            count[path.stem] += sum(type(number) in (int, float) and number != 0 for number in found)
    return count


def names_of(node: ast.Assign | ast.AnnAssign) -> set[str]:
    """Names that an assignment gives."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}


def walk_outside(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes below one but those inside functions."""
    if not isinstance(node, ast.Lambda | ast.FunctionDef):
        yield node
        for below in ast.iter_child_nodes(node):
            yield from walk_outside(below)


def unnamed_numbers(root: Path) -> int:
    """Fractions inside registration's functions that are neither plain nor mere guards against rounding."""
    count = 0
    for path in (root / "src/magmatch/registration").rglob("*.py"):
        if path.parent.name == "published" or path.name in ("result.py", "mapped_arrays.py"):
            continue
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef | ast.Lambda):
                found = [n.value for n in ast.walk(function) if isinstance(n, ast.Constant)]
                count += sum(type(x) is float and x not in PLAIN and 1e-6 <= x < 1e6 for x in found)
    return count


def exported() -> int:
    """Names that the package itself gives."""
    import magmatch

    return len(magmatch.__all__)


def calls_to_search() -> list[str]:
    """Functions on the stack below `register` when the first step of the search begins, outermost first."""
    import threading
    from inspect import unwrap

    import magmatch as mm
    from magmatch.field.config import SPLINE
    from magmatch.registration.register import register

    class Found(BaseException):
        """The first step has begun."""

    pair = mm.simulate("office-random", 0)
    maps = [mm.build_map(survey, SPLINE) for survey in (pair.base, pair.target)]
    found: list[str] = []

    def watch(frame: object, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        is_search = "registration/search/" in path.as_posix() or (
            path.parent.name == "registration" and path.stem in STEPS
        )
        if event != "call" or not is_search:
            return
        stack = [frame]
        while stack[-1] is not None and stack[-1].f_code is not unwrap(register).__code__:
            stack.append(stack[-1].f_back)
        if stack.pop() is None:
            return
        found[:] = [f"{Path(f.f_code.co_filename).name}:{f.f_code.co_name}" for f in stack[::-1]]
        raise Found

    threading.setprofile(watch)
    sys.setprofile(watch)
    try:
        register(*maps)
    except Found:
        pass
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return found


def figures(root: Path) -> dict[str, object]:
    """All figures of one checkout."""
    rooms = lines(root)
    counted = sum((found for room, found in rooms.items() if room != "tests"), Counter())
    path = asked_inside(root, "calls_to_search")
    pages = verb_pages(root)
    return {
        "Python files outside the tests": counted["files"],
        **{f"lines, {kind}": counted[kind] for kind in LINE_KINDS},
        "lines, code and docstring": counted["code"] + counted["docstring"],
        "lines of the tests, all": rooms.get("tests", Counter())["all"],
        "words of the documentation": sum(len((root / p).read_text().split()) for p in files_of(root, ".md")),
        "largest folders": ", ".join(f"{name} {n}" for name, n in largest_folders(root)),
        "settings": asked_inside(root, "all_settings"),
        "settings of registration": asked_inside(root, "settings"),
        "numbers with a name of a module": named_numbers(root),
        "calls of isinstance": asked_kinds(root),
        "numbers chosen in registration": numbers(root),
        "of them limits of effort": numbers_by_file(root)["limits"],
        "further numbers inside its functions": unnamed_numbers(root),
        "names of the package": asked_inside(root, "exported"),
        "public functions and classes": public_names(root),
        "longest page of an algorithm": "; ".join(f"{name} {n}" for name, n in pages.items()),
        "import contracts": contracts(root),
        "calls from register to the search": f"{len(path)}: {' > '.join(path)}",
    }


def print_table(rows: list[list[object]]) -> None:
    for k, row in enumerate(rows):
        print("| " + " | ".join(f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row) + " |")
        if k == 0:
            print("| " + " | ".join("---" for _ in row) + " |")


def main() -> None:
    roots = [Path(word).resolve() for word in sys.argv[1:]] or [HERE.parents[1]]
    found = [figures(root) for root in roots]
    print_table(
        [["figure", *[root.name for root in roots]], *([name, *(f[name] for f in found)] for name in found[0])]
    )
    for root in roots:
        print(f"\n{root.name}\n")
        rooms = lines(root)
        print_table(
            [
                ["folder", "files", *LINE_KINDS],
                *([r, n["files"], *(n[k] for k in LINE_KINDS)] for r, n in rooms.items()),
            ]
        )


if __name__ == "__main__":
    main()
