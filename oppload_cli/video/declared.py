"""What a container declares of its length, as far as it can be believed."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import av

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream


def declared_frames(container: InputContainer, stream: VideoStream) -> int | None:
    """Return how many frames a container says that it shows.

    Its own count is of samples: those that an edit list hides, and the empty ones by
    which AVI fills gaps, never come out. The index tells them apart.

    Parameters
    ----------
    container : av.container.InputContainer
        An open file or stream.
    stream : av.VideoStream
        One of its streams.

    Returns
    -------
    int or None
        None where it says nothing that can be believed (IVF counts ticks).
    """
    kind = container.format.name
    entries = stream.index_entries
    if kind.startswith("mov") and len(entries):
        return sum(not entry.is_discard for entry in entries)
    # The index of a truncated AVI file is gone, or made from what has been read.
    if kind == "avi" and len(entries) and entries[-1].timestamp + 2 >= stream.frames:
        return len(entries)
    return (stream.frames or None) if kind.startswith(("mov", "avi", "gif", "apng")) else None


def declared_end(container: InputContainer, stream: VideoStream) -> float | None:
    """Return when a stream ends by its own declaration, on the clock of its frames.

    Parameters
    ----------
    container : av.container.InputContainer
        An open file or stream.
    stream : av.VideoStream
        One of its streams.

    Returns
    -------
    float or None
        In seconds; None where the container declares none, or only that of a sound.
    """
    if not container.format.name.startswith(("matroska", "ivf")):
        return None  # elsewhere it is guessed from what the file still holds
    tag = re.match(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    if tag:
        hours, minutes, seconds = tag.groups()
        return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    if len(container.streams) == 1 and container.duration is not None:
        return container.duration / av.time_base
    return None
