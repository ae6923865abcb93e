"""Bare decoding, the limit: a process of its own that imports the decoder alone.

``python benchmarks/decoding.py FILE`` decodes every frame and touches its luma plane.
"""

from __future__ import annotations

import sys
from pathlib import Path  # noqa: TC003 - shown in a signature

import av


def decode(path: str | Path) -> int:
    """Return how many frames were decoded."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        return sum(memoryview(frame.planes[0]).nbytes > 0 for frame in container.decode(stream))


if __name__ == "__main__":
    decode(sys.argv[1])
