"""Bare decoding, in a process that imports only the decoder: the least time of a run.

``python benchmarks/decoding.py FILE`` decodes every frame and reads the size of its luma plane.
"""

import os
import sys

import av


def decode(path: str | os.PathLike[str]) -> int:
    """Return the number of decoded frames."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        return sum(memoryview(frame.planes[0]).nbytes > 0 for frame in container.decode(stream))


if __name__ == "__main__":
    decode(sys.argv[1])
