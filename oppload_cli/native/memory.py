"""How the C library deals with memory that is freed."""

from __future__ import annotations

import ctypes
from contextlib import suppress

# From <malloc.h> of the GNU C library: what may stay free at the end of the heap, and
# from what size on memory is taken for an array alone (32 MiB is the most it accepts).
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT, ALONE = 1 << 27, 1 << 25


def keep_freed() -> None:
    """Keep what one frame has freed for the next one, which needs as much.

    By default it is given back and taken again, 100 pages for each array of a frame:
    a twentieth of a run. Other C libraries than GNU's are left as they are.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(M_TRIM_THRESHOLD, KEPT)
        library.mallopt(M_MMAP_THRESHOLD, ALONE)
