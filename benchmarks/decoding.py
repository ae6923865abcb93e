"""Bare decoding: a process of its own that imports only the decoder. No run can be faster.

``python benchmarks/decoding.py FILE`` decodes every frame and looks at the size of its luma plane.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import av

if TYPE_CHECKING:
    from pathlib import Path


def decode(path: str | Path) -> int:
    """Return the number of decoded frames."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        return sum(memoryview(frame.planes[0]).nbytes > 0 for frame in container.decode(stream))


if __name__ == "__main__":
    decode(sys.argv[1])
