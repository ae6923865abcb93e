"""A Sphinx extension that runs the code on pages of the documentation while the site is built.

A block ``run`` of a page shows its code, runs it, and shows its output::

    ```{run} sh
    oppload run video.mp4
    ```

Every page has its own folder, in which its blocks run one after the other. At first the folder
contains ``video.mp4``, a disk that approaches, and the folder ``videos`` with three videos. Python
blocks of a page share their names. A block that fails ends the build with an error.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import sys
import traceback
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import TYPE_CHECKING, Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

from oppload_cli import stimulus

if TYPE_CHECKING:
    from collections.abc import Callable

    from sphinx.application import Sphinx

# Files above docs/, and the page of the site that includes each of them.
_OUTSIDE = {
    "CONTRIBUTING.md": "development/contributing.md",
    "CHANGELOG.md": "development/changes.md",
}
_RUNS = Path("_build", "runs")
_EXAMPLES = {
    "video": "controls/looming-and-translating",
    "videos/approach": "controls/looming-perspective",
    "videos/passing-by": "controls/translating-disk-speed/speed-80",
    "videos/retreat": "controls/receding-patch",
}
_WIDTH = 88  # characters of a line of output


class Run(SphinxDirective):
    """Show a block of code, its output and the picture that it writes.

    Options: ``picture``, the file of the picture; ``alt``, its description; ``exit``, the expected
    exit code; ``last``, the number of lines to show from the end of the output; ``hidden``, to
    show only the picture.
    """

    has_content = True
    required_arguments = 1
    option_spec: ClassVar[dict[str, Callable[[str], Any]]] = {
        "picture": directives.unchanged,
        "alt": directives.unchanged,
        "exit": directives.nonnegative_int,
        "last": directives.nonnegative_int,
        "hidden": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Run the block and return the nodes of the page."""
        language, code = self.arguments[0], "\n".join(self.content)
        page = self.env.temp_data.setdefault("run", {})
        if not page:
            page.update(folder=_prepared(self.env.app, self.env.docname), names={})
        if language == "python":
            printed, status = _python(code, page["names"], page["folder"])
        else:
            printed, status = _shell(code, page["folder"])
        if status != self.options.get("exit", 0):
            raise self.error(f"this block ended with {status}:\n{code}\n{printed}")
        shown: list[nodes.Node] = []
        if "hidden" not in self.options:
            shown.append(nodes.literal_block(code, code, language=language))
            lines = printed.rstrip().splitlines()[-self.options.get("last", 1000) :]
            text = "\n".join(lines)
            if text:
                shown.append(nodes.literal_block(text, text, language="text", classes=["output"]))
        if "picture" in self.options:
            uri = f"/{(_RUNS / self.env.docname / self.options['picture']).as_posix()}"
            shown.append(nodes.image(uri=uri, alt=self.options.get("alt", "")))
        return shown


def _prepared(app: Sphinx, page: str) -> Path:
    """Make the folder of a page, with the example videos, and return it."""
    folder = Path(app.srcdir) / _RUNS / page
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(Path(app.srcdir) / _RUNS / "examples", folder)
    return folder


def _shell(code: str, folder: Path) -> tuple[str, int]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    env = {**os.environ, "PATH": path, "COLUMNS": str(_WIDTH), "MPLBACKEND": "agg"}
    command = [shutil.which("bash") or "bash", "-euc", code]
    done = subprocess.run(
        command, cwd=folder, env=env, stdout=PIPE, stderr=STDOUT, text=True, check=False
    )
    return done.stdout, done.returncode


def _python(code: str, names: dict[str, Any], folder: Path) -> tuple[str, int]:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.chdir(folder):
        try:
            exec(compile(code, "block", "exec"), names)  # noqa: S102 - the page's own code
        except Exception:  # Sphinx reports the block and continues
            return printed.getvalue() + traceback.format_exc(), 1
    return printed.getvalue(), 0


def _make_examples(app: Sphinx) -> None:
    """Make the videos that the folder of every page contains at first."""
    folder = Path(app.srcdir) / _RUNS / "examples"
    for name, shown in _EXAMPLES.items():
        target = (folder / name).with_suffix(".mp4")
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            made = stimulus.write(stimulus.load(shown), folder / "made", form="mp4")
            made.video.replace(target)
            shutil.rmtree(folder / "made")


def _escape_stars(_app: Sphinx, _context: object, lines: list[str]) -> None:
    """Escape the ``*`` of patterns in help texts, which would otherwise mean emphasis."""
    lines[:] = [line.replace("*", r"\*") for line in lines]


def _link_inside(_app: Sphinx, page: str, source: list[str]) -> None:
    """Change links to files above ``docs`` into links to the pages that include these files."""
    up = "../" * page.count("/")
    for name, included in _OUTSIDE.items():
        source[0] = source[0].replace(f"](../{up}{name}", f"]({up}{included}")


def _changed(*_: object) -> list[str]:
    """Return the page that shows the commands: Sphinx does not see that their code has changed."""
    return ["reference/commands"]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive and the functions with Sphinx."""
    app.add_directive("run", Run)
    app.connect("builder-inited", _make_examples)
    app.connect("source-read", _link_inside)
    app.connect("env-get-outdated", _changed)
    app.connect("sphinx-click-process-description", _escape_stars)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
