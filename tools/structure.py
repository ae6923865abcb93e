"""Measure the structure of the package.

    python tools/structure.py [CHECKOUT]   # print the figures of a checkout
    python tools/structure.py --table      # write the figures of this checkout into the docs

The last two figures come from a run that `tools.tracer` watches, and need the libraries of
oppload. All others come from the text of the source.
"""  # fmt: skip

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
import tokenize
from collections import Counter
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

PACKAGE = "oppload_cli"
ROOT = Path(__file__).resolve().parents[1]
_PAGE = ROOT / "docs" / "development" / "structure.md"
_MARKS = ("<!-- structure: begin -->\n", "<!-- structure: end -->\n")

# A room may import from the layers below its own, and within its layer without a circle.
# A room is a folder, or a single file at the top of the package.
LAYERS: dict[str, tuple[str, ...]] = {
    "commands": (PACKAGE, "__main__", "cli", "api"),
    "work": (
        *("batch", "evaluation", "reproduction", "tuning", "pipeline", "annotation", "plots"),
        "report",
    ),
    "answers": ("stimulus", "detection", "results"),
    "science": ("models", "motion", "video"),
    "machine": ("compute", "processes", "files", "environment"),
    "ground": ("schema", "errors", "palette", "reference", "version"),
}

# Each figure before the package was laid out in these rooms, and the largest value that is wanted
# (None: no aim was set). The keys are in the order of the table.
BEFORE_AND_AIM: dict[str, tuple[float, float | None]] = {
    "files that name a detector, outside `models` and `reproduction`": (24, 3),
    "modules of `models`": (25, 14),
    "imports inside `models`": (83, 35),
    "lines of `models`": (3531, 1900),
    "lines of Python": (29012, 24000),
    "lines of C": (1141, 850),
    "modules": (200, 130),
    "modules with one importer": (67, 20),
    "modules with one public name": (61, None),
    "`noqa`": (158, 40),
    "imports in functions": (118, 40),
    "imports in functions, outside `cli`": (39, None),
    "public names per 1,000 lines of code": (33.3, 22),
    "import circles": (0, 0),
    "import circles, with those for types": (3, 0),
    "files entered by a run": (72, 25),
    "climbs of a run": (3, 5),
}

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
    text = {name: path.read_text("utf-8") for name, path in modules.items()}
    trees = {name: _tree(path) for name, path in modules.items()}
    lines = {name: each.count("\n") for name, each in text.items()}
    code = sum(_code_lines(path, trees[name]) for name, path in modules.items())
    public = {name: _public_names(tree) for name, tree in trees.items()}
    graph = import_graph(modules)
    files = [name for name, path in modules.items() if path.name != "__init__.py"]
    models = {name for name in files if room_of(name) == "models"}
    importers = Counter(other for imported in graph.values() for other in imported)
    c_files = [path for path in (root / PACKAGE).rglob("*") if path.suffix in {".c", ".h"}]
    return {
        "files that name a detector, outside `models` and `reproduction`": len(
            detector_names(root)
        ),
        "modules of `models`": len(models),
        "imports inside `models`": sum(len(graph[name] & models) for name in models),
        "lines of `models`": sum(n for name, n in lines.items() if room_of(name) == "models"),
        "lines of Python": sum(lines.values()),
        "lines of C": sum(path.read_text("utf-8").count("\n") for path in c_files),
        "modules": len(files),
        "modules with one importer": sum(importers[name] == 1 for name in files),
        "modules with one public name": sum(public[name] == 1 for name in files),
        "`noqa`": sum(each.count("# noqa") for each in text.values()),
        "imports in functions": sum(_imports_in_functions(tree) for tree in trees.values()),
        "imports in functions, outside `cli`": sum(
            _imports_in_functions(tree) for name, tree in trees.items() if room_of(name) != "cli"
        ),
        "public names per 1,000 lines of code": round(1000 * sum(public.values()) / code, 1),
        "import circles": len(circles(import_graph(modules, types=False))),
        "import circles, with those for types": len(circles(graph)),
    }


def figures_of_run(root: Path) -> dict[str, float]:
    """Return the figures of a run from the command to its CSV file, by title.

    `tools.tracer` runs ``oppload run`` on a small clip and notes each call from a module of the
    package into another one. A climb is a pair of modules in which the room of the caller lies in
    a lower layer than the room of the called module.
    """
    with TemporaryDirectory() as folder:
        log = Path(folder, "calls")
        tracer = Path(__file__).with_name("tracer.py")
        command = [sys.executable, str(tracer), str(root), str(log), folder]
        subprocess.run(command, check=True, capture_output=True)
        pairs = {tuple(line.split(" ")) for line in log.read_text("utf-8").splitlines()}
    layers = {module: layer_of(room_of(module)) for pair in pairs for module in pair if module}
    return {
        "files entered by a run": len(layers),
        "climbs of a run": sum(layers[called] < layers[by] for by, called in pairs if by),
    }


def detector_names(root: Path) -> list[str]:
    """Return the modules outside `models` and `reproduction` whose code names a detector."""
    trees = {
        name: _tree(path) for name, path in modules_of(root).items() if path.name != "__init__.py"
    }
    models = (tree for name, tree in trees.items() if room_of(name) == "models")
    detectors = {name for tree in models for name in _names_of_classes(tree)}
    return [
        name
        for name, tree in trees.items()
        if room_of(name) not in {"models", "reproduction"} and _names_a_detector(tree, detectors)
    ]


def _table(figures: dict[str, float]) -> str:
    """Return the Markdown table of the figures before and now."""
    lines = ["| measurement | before | aim | now |", "|---|---|---|---|"]
    for title, now in figures.items():
        before, aim = BEFORE_AND_AIM[title]
        lines.append(f"| {title} | {before:,} | {'' if aim is None else f'{aim:,}'} | {now:,} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the figures of a checkout, or write the table of the documentation."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "checkout", type=Path, nargs="?", default=ROOT, help="its folder (this one)"
    )
    parser.add_argument("--table", action="store_true", help=f"write the figures into {_PAGE.name}")
    arguments = parser.parse_args()
    root = arguments.checkout
    if not modules_of(root):
        parser.error(f"{root}: is no checkout: it has no folder {PACKAGE}")
    figures = figures_of_source(root)
    if find_spec("av"):
        figures |= figures_of_run(root)
    if arguments.table:
        begin, end = _MARKS
        before, rest = _PAGE.read_text("utf-8").split(begin)
        after = rest.split(end)[1]
        _PAGE.write_text(before + begin + _table(figures) + end + after, "utf-8")
        return
    for title, value in figures.items():
        sys.stdout.write(f"{title:66} {value}\n")
    sys.stdout.write(f"files that name a detector: {', '.join(detector_names(root))}\n")


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


def _public_names(tree: ast.Module) -> int:
    """Return the number of public functions and classes at the top level of a module."""
    kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    return sum(isinstance(node, kinds) and not node.name.startswith("_") for node in tree.body)


def _imports_in_functions(tree: ast.Module) -> int:
    imports = {
        node
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    return len(imports)


def _names_of_classes(tree: ast.Module) -> set[str]:
    """Return the values of the attribute `name` of the classes of a module."""
    names = set()
    classes = (each for each in tree.body if isinstance(each, ast.ClassDef))
    for statement in (statement for each in classes for statement in each.body):
        match statement:
            case ast.Assign(targets=[ast.Name(id="name")], value=ast.Constant(value=str(text))):
                names.add(text)
    return names


def _names_a_detector(tree: ast.Module, detectors: set[str]) -> bool:
    """Tell whether the code of a module, without its docstrings, names a detector."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    words = [_word(node) for node in ast.walk(tree) if id(node) not in docstrings]
    return any(
        name in word.lower().replace("oppload", "").replace("opplod2023", "")
        for word in words
        for name in detectors
    )


def _word(node: ast.AST) -> str:
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.Name(id=word) | ast.Attribute(attr=word) | ast.alias(name=word):
            return word
    return ""


if __name__ == "__main__":
    main()
