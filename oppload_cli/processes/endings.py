"""How a process ended."""

from __future__ import annotations

import signal
from contextlib import suppress


def ending(code: int | None) -> str:
    """Say how a process ended.

    Parameters
    ----------
    code : int or None
        Its exit code; the negative number of the signal that ended it.

    Returns
    -------
    str
        Such as ``SIGKILL`` or ``exit code 1``.
    """
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"
