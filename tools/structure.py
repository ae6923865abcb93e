"""Measure the structure of the package.

    python tools/structure.py [CHECKOUT]   # print the figures of a checkout

All figures but those of a middle frame come from the text of the source. A middle frame is the
tenth frame of an `oppload_cli.Analysis`, from the array to its row of the table; each call of a
function of the package counts.
"""  # fmt: skip

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
import tokenize
from collections import Counter
from functools import cache
from pathlib import Path

PACKAGE = "oppload_cli"
ROOT = Path(__file__).resolve().parents[1]
# A room may import from the layers below its own, and within its layer without a circle.
# A room is a folder, or a single file at the top of the package.
LAYERS: dict[str, tuple[str, ...]] = {
    "commands": (PACKAGE, "__main__", "cli", "api"),
    "work": (
        *("batch", "evaluation", "reproduction", "tuning", "pipeline", "annotation", "plots"),
        "report",
    ),
    "answers": ("stimulus", "detection", "frames", "results"),
    "science": ("models", "motion", "video"),
    "machine": ("compute", "processes", "files", "environment"),
    "ground": ("schema", "errors", "palette", "reference", "frame_times", "version"),
}

# The way from a frame to OppLoD's response.
OPPLOD = (
    "models/opplod*.py",
    "models/opposing_motion.py",
    "models/agreement.py",
    "models/arms.py",
    "models/units.py",
    "models/dpc.py",
    "models/layers.py",
    "models/timebase.py",
    "pipeline/repeats.py",
    "pipeline/one_pass.py",
    "frames/*.py",
    "frame_times.py",
)
_SCIENCE = {"models", "detection", "motion", "frames", "frame_times"}
_MIDDLE_FRAME = """
import sys
import numpy as np
import oppload_cli

analysis = oppload_cli.Analysis((240, 320), rate=30, rmo=True)
y, x = np.mgrid[:240, :320]
events = []
def seen(frame, event, _):
    if event == "call" and "/oppload_cli/" in frame.f_code.co_filename:
        events.append(frame.f_code.co_filename)
for number in range(10):
    disk = np.clip(np.hypot(x - 160, y - 120) - 400 / (40 - number), 0, 1)
    if number == 9:
        sys.setprofile(seen)
    analysis.step(disk, number / 30).values()
    sys.setprofile(None)
print(len(set(events)), sum(a != b for a, b in zip(events, events[1:])), len(events))
"""

Graph = dict[str, set[str]]


def room_of(module: str) -> str:
    """Return the room of a module: the first name below the package."""
    return module.split(".")[1] if "." in module else module


def layer_of(room: str) -> int:
    """Return the number of a room's layer, 0 at the top."""
    for number, rooms in enumerate(LAYERS.values()):
        if room in rooms:
            return number
    raise ValueError(f"{room} has no layer: add it to LAYERS in tools/structure.py")


def modules_of(root: Path) -> dict[str, Path]:
    """Return the file of every module and package below `root`, by dotted name."""
    found = {}
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


@cache
def _naming(path: Path) -> list[ast.AST]:
    """Return the parts of a module that may name another module."""
    kinds = ast.Constant | ast.Import | ast.ImportFrom
    return [node for node in ast.walk(_tree(path)) if isinstance(node, kinds)]


def import_graph(modules: dict[str, Path], *, types: bool = True) -> Graph:
    """Return the modules of the package that each of `modules` imports.

    With `types`, imports inside functions and for type checking count too. Otherwise only imports
    that run when the module is imported count.
    """
    graph: Graph = {}
    for module, path in modules.items():
        nodes = _naming(path) if types else _run_when_imported(_tree(path))
        graph[module] = {name for node in nodes for name in _imported_names(node, modules)}
    return graph


def room_graph(root: Path) -> Graph:
    """Return the rooms that each room imports, also if only for types."""
    rooms: Graph = {}
    for module, imported in import_graph(modules_of(root)).items():
        room = room_of(module)
        rooms.setdefault(room, set()).update({room_of(other) for other in imported} - {room})
    return rooms


def reachable(graph: Graph, start: str) -> set[str]:
    """Return all nodes that a path from `start` leads to; `start` itself only in a circle."""
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting.extend(graph[node])
    return found


def circles(graph: Graph) -> set[frozenset[str]]:
    """Return the groups of nodes that reach each other."""
    reach = {node: reachable(graph, node) for node in graph}
    return {
        frozenset(other for other in reach[node] if node in reach[other])
        for node in graph
        if node in reach[node]
    }


def figures_of_source(root: Path) -> dict[str, float]:
    """Return the figures that follow from the source text, by title."""
    modules = modules_of(root)
    trees = {name: _tree(path) for name, path in modules.items()}
    code = sum(_code_lines(path, trees[name]) for name, path in modules.items())
    opplod = [path for pattern in OPPLOD for path in (root / PACKAGE).glob(pattern)]
    classes = Counter(
        node.name for tree in trees.values() for node in tree.body if isinstance(node, ast.ClassDef)
    )
    files = Counter(path.name for path in modules.values() if path.name != "__init__.py")
    tests = list((root / "tests").rglob("*.py"))
    return {
        "lines of code": code,
        "lines of code from a frame to OppLoD's response": sum(
            _code_lines(path, _tree(path)) for path in opplod
        ),
        "modules": len(modules),
        "declared parameters": sum(
            _parameters(tree) for name, tree in trees.items() if _is_of_a_run(name)
        ),
        "private numeric constants of the science": sum(
            _private_numbers(tree) for name, tree in trees.items() if room_of(name) in _SCIENCE
        ),
        "private top-level names per 1,000 lines of code": round(
            1000 * sum(map(_private_names, trees.values())) / code, 1
        ),
        "loops whose variable is `each`": sum(map(_each_loops, trees.values())),
        "class names that exist twice": sum(count > 1 for count in classes.values()),
        "module names that exist twice": sum(count > 1 for count in files.values()),
        "lines of tests": sum(path.read_text("utf-8").count("\n") for path in tests),
        "import circles": len(circles(import_graph(modules, types=False))),
    }


def figures_of_a_frame(root: Path) -> dict[str, float]:
    """Return how many files a middle frame enters, how often it changes the file, and its calls."""
    done = subprocess.run(
        [sys.executable, "-c", _MIDDLE_FRAME], cwd=root, check=True, capture_output=True, text=True
    )
    files, changes, calls = map(int, done.stdout.split())
    return {
        "a middle frame: files": files,
        "a middle frame: changes of the file": changes,
        "a middle frame: calls": calls,
    }


def main() -> None:
    """Print the figures of a checkout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "checkout", type=Path, nargs="?", default=ROOT, help="its folder (this one)"
    )
    root = parser.parse_args().checkout.resolve()
    if not modules_of(root):
        parser.error(f"{root}: is no checkout: it has no folder {PACKAGE}")
    for title, value in (figures_of_source(root) | figures_of_a_frame(root)).items():
        sys.stdout.write(f"{title:52} {value:,}\n")


def _is_of_a_run(module: str) -> bool:
    return room_of(module) in {"models", "detection", "motion", "frames", "pipeline"}


def _parameters(tree: ast.Module) -> int:
    """Return the number of values that are declared by `parameter`, or a helper for seconds."""
    return sum(
        isinstance(node, ast.AnnAssign)
        and isinstance(node.value, ast.Call)
        and getattr(node.value.func, "id", "") in {"parameter", "_seconds"}
        for node in ast.walk(tree)
    )


def _private_numbers(tree: ast.Module) -> int:
    """Return the number of private constants at the top level that are numbers, or hold some."""
    count = 0
    for node in tree.body:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                private = [name for name in names if getattr(name, "id", "").startswith("_")]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                numbers = all(_is_number(value) for value in values)
                count += len(private) * numbers
    return count


def _is_number(node: ast.AST) -> bool:
    """Return whether an expression is made of numbers alone, such as ``1 / 3`` or ``-2``."""
    parts = [part for part in ast.walk(node) if isinstance(part, ast.expr)]
    kinds = ast.Constant | ast.UnaryOp | ast.BinOp
    return all(
        isinstance(part, kinds)
        and not (isinstance(part, ast.Constant) and isinstance(part.value, bool | str | bytes))
        for part in parts
    )


def _private_names(tree: ast.Module) -> int:
    """Return the number of private functions, classes and constants at the top level."""
    names: list[str] = []
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                parts = target.elts if isinstance(target, ast.Tuple) else [target]
                names += [getattr(part, "id", "") for part in parts]
    return sum(name.startswith("_") and not name.startswith("__") for name in names)


def _each_loops(tree: ast.Module) -> int:
    loops = (node for node in ast.walk(tree) if isinstance(node, ast.For | ast.comprehension))
    return sum(
        getattr(name, "id", "") == "each" for loop in loops for name in ast.walk(loop.target)
    )


def _run_when_imported(tree: ast.Module) -> list[ast.stmt]:
    """Return the statements at the top level, without the block for type checking."""
    return [
        node
        for node in tree.body
        if not (isinstance(node, ast.If) and isinstance(node.test, ast.Name))
    ]


def _imported_names(node: ast.AST, modules: dict[str, Path]) -> set[str]:
    names: set[str] = set()
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        # The registry names a detector that is loaded later: "models.published.lgmd2:Lgmd2".
        module, _, name = node.value.partition(":")
        names = {f"{PACKAGE}.{module}"} if name.isidentifier() else names
    elif isinstance(node, ast.Import):
        names = {alias.name for alias in node.names}
    elif isinstance(node, ast.ImportFrom) and node.module:
        for alias in node.names:
            full = f"{node.module}.{alias.name}"
            names.add(full if full in modules else node.module)
    return names & modules.keys()


def _code_lines(path: Path, tree: ast.Module) -> int:
    """Return the number of lines that hold code: no blank line, comment or docstring."""
    lines: set[int] = set()
    skipped = (
        *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
        *(tokenize.ENCODING, tokenize.ENDMARKER),
    )
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in skipped:
                lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines.difference_update(range(first.lineno, (first.end_lineno or 0) + 1))
    return len(lines)


if __name__ == "__main__":
    main()
