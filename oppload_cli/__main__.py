"""The process ``oppload``, also as ``python -m oppload_cli``."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from typing import TYPE_CHECKING, NoReturn

from oppload_cli import interruption

if TYPE_CHECKING:
    from oppload_cli.video.apart import DecodingProcess

SWITCH_S = 0.0005  # a thread that waits for Python's lock gets it within a fraction of a frame
GARBAGE_AFTER = 50_000  # objects: what imports make stays, and looking through it takes 30 ms


def entry() -> NoReturn:
    """Be the process: run the command line, then leave at once.

    Taking the interpreter apart costs a twentieth of a second, and threads of libraries
    may still be at work meanwhile.
    """
    # Nothing here multiplies large matrices, and starting threads for it takes a tenth of a second.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.setswitchinterval(SWITCH_S)
    gc.set_threshold(GARBAGE_AFTER)
    apart = _standing_by(sys.argv[1:])
    from oppload_cli.cli import main  # noqa: PLC0415 - while the other process loads what it needs
    from oppload_cli.errors import ExitCode  # noqa: PLC0415

    try:
        main(apart=apart)
    except SystemExit as ended:
        interruption.ignore()
        if apart is not None:
            apart.close()
        atexit._run_exitfuncs()
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError, AttributeError):
            raise ended from None  # Python says in its own way what cannot be written
        os._exit(ended.code if isinstance(ended.code, int) else ExitCode.BUG)


def _standing_by(words: list[str]) -> DecodingProcess | None:
    """Start the process that decodes if it will be of use: before all else, for it has to load."""
    if words[:1] != ["run"] or {"-h", "--help"}.intersection(words):
        return None
    from oppload_cli.video.apart import DecodingProcess  # noqa: PLC0415 - one command's

    return DecodingProcess.if_possible()


if __name__ == "__main__":
    entry()
