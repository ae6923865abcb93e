"""The process ``oppload``, also as ``python -m oppload_cli``."""

from __future__ import annotations

import atexit
import os
import sys
from io import TextIOWrapper
from typing import NoReturn

from oppload_cli.cli import main


def entry() -> NoReturn:
    """Run the command line and exit at once.

    The exit does not delete every object of the interpreter, which would take 0.06 s, 4 % of a run.
    """
    _set_standard_output()
    # oppload multiplies no large matrices; starting threads for them takes 0.1 s.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # OpenCV prints lines if the system refuses a thread; oppload's error says the same. With some
    # levels OpenCV prints to standard output, which is for data.
    os.environ["OPENCV_LOG_LEVEL"] = "SILENT"
    # Figures become files, so that matplotlib needs no display.
    os.environ["MPLBACKEND"] = "agg"
    # Figures hold no date, but matplotlib fails if this variable is no number.
    os.environ.pop("SOURCE_DATE_EPOCH", None)
    # Without this variable, a process of `--jobs` would import a `signal.py` of the current folder
    # in place of Python's.
    os.environ["PYTHONSAFEPATH"] = "1"
    # With these allocators, Arrow starts no thread.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    try:
        main()
    except SystemExit as ended:
        atexit._run_exitfuncs()
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError, AttributeError):
            raise ended from None  # Python's normal exit reports a closed or full stream
        os._exit(int(ended.code or 0))


def _set_standard_output() -> None:
    """Print names of files that are not UTF-8 as their bytes, and escape what else does not fit.

    Lines end as they do in files that oppload writes, also on Windows.
    """
    if isinstance(sys.stdout, TextIOWrapper):
        as_bytes = os.name == "posix" and sys.stdout.encoding.lower() == "utf-8"
        errors = "surrogateescape" if as_bytes else "backslashreplace"
        sys.stdout.reconfigure(errors=errors, newline="\n")


if __name__ == "__main__":
    entry()
