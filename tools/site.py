"""The extension of the documentation's site: code that is run while the site is built.

A block ``run`` of a page shows its code, runs it, and shows what it prints::

    ```{run} sh
    oppload run video.mp4
    ```

The blocks of a page run one after the other in a folder of the page's own, in which
``video.mp4``, a disk that approaches, and the folder ``videos`` with three videos lie already.
Python blocks share their names. A block that fails fails the build.
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
from typing import TYPE_CHECKING, Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

from oppload_cli import stimulus

if TYPE_CHECKING:
    from collections.abc import Callable

    from sphinx.application import Sphinx

# Files above docs/ that are pages of the site, and the page that includes each.
OUTSIDE = {
    "CONTRIBUTING.md": "development/contributing.md",
    "CHANGELOG.md": "development/changes.md",
}
RUNS = Path("_build", "runs")
EXAMPLES = {
    "video": "controls/looming-and-translating",
    "videos/approach": "controls/looming-perspective",
    "videos/passing-by": "controls/translating-disk-speed/speed-80",
    "videos/retreat": "controls/receding-patch",
}
WIDTH = 88  # characters of output


class Run(SphinxDirective):
    """Show a block of code, what it prints and the pictures that it makes.

    Options: ``picture``, a file that the code writes; ``alt``, its description; ``exit``, the
    exit code that is right; ``last``, the number of last lines of output that are shown;
    ``hidden``, show nothing but the picture.
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
        """Run the block and return what the page shows."""
        language, code = self.arguments[0], "\n".join(self.content)
        kept = self.env.temp_data.setdefault("run", {})
        if not kept:
            kept.update(folder=_prepared(self.env.app, self.env.docname), names={})
        if language == "python":
            printed, status = _python(code, kept["names"], kept["folder"])
        else:
            printed, status = _shell(code, kept["folder"])
        if status != self.options.get("exit", 0):
            raise self.error(f"this block ended with {status}:\n{code}\n{printed}")
        shown: list[nodes.Node] = []
        lines = printed.rstrip().splitlines()[-self.options.get("last", 1000) :]
        if "hidden" not in self.options:
            shown.append(nodes.literal_block(code, code, language=language))
        if lines and "hidden" not in self.options:
            text = "\n".join(lines)
            shown.append(nodes.literal_block(text, text, language="text", classes=["output"]))
        if "picture" in self.options:
            uri = f"/{(RUNS / self.env.docname / self.options['picture']).as_posix()}"
            shown.append(nodes.image(uri=uri, alt=self.options.get("alt", "")))
        return shown


def _prepared(app: Sphinx, page: str) -> Path:
    """Return the folder of a page's blocks, with the example videos in it."""
    folder = Path(app.srcdir) / RUNS / page
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(Path(app.srcdir) / RUNS / "examples", folder)
    return folder


def _shell(code: str, folder: Path) -> tuple[str, int]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    own = {"PATH": path, "COLUMNS": str(WIDTH), "MPLBACKEND": "agg"}
    done = subprocess.run(
        [shutil.which("bash") or "bash", "-euc", code],
        cwd=folder,
        env={**os.environ, **own},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.stdout, done.returncode


def _python(code: str, names: dict[str, Any], folder: Path) -> tuple[str, int]:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.chdir(folder):
        try:
            exec(compile(code, "block", "exec"), names)  # noqa: S102 - the page's own code
        except Exception:  # whatever it is, Sphinx names the block and goes on
            return printed.getvalue() + traceback.format_exc(), 1
    return printed.getvalue(), 0


def make_examples(app: Sphinx) -> None:
    """Make the videos that every page's folder begins with."""
    folder = Path(app.srcdir) / RUNS / "examples"
    for name, shown in EXAMPLES.items():
        target = (folder / name).with_suffix(".mp4")
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            made = stimulus.write(stimulus.load(shown), folder / "made", form="mp4")
            made.video.replace(target)
            shutil.rmtree(folder / "made")


def escape_stars(_app: Sphinx, _context: object, lines: list[str]) -> None:
    """Keep patterns such as ``clips/*.mp4`` in the help of commands from being read as emphasis."""
    lines[:] = [line.replace("*", r"\*") for line in lines]


def link_inside(_app: Sphinx, page: str, source: list[str]) -> None:
    """Let links to files above ``docs`` lead to the pages of the site that include them."""
    up = "../" * page.count("/")
    for name, included in OUTSIDE.items():
        source[0] = source[0].replace(f"](../{up}{name}", f"]({up}{included}")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register all of this with Sphinx."""
    app.add_directive("run", Run)
    app.connect("builder-inited", make_examples)
    app.connect("source-read", link_inside)
    app.connect("sphinx-click-process-description", escape_stars)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
