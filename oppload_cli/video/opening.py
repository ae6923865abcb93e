"""Begins to open and decode an input while the models are still to be loaded."""

from __future__ import annotations

import os.path
from typing import TYPE_CHECKING

from oppload_cli.video.inputs import IMAGE_SUFFIXES
from oppload_cli.video.prefetch import Call
from oppload_cli.video.span import Span

if TYPE_CHECKING:
    from fractions import Fraction

    from oppload_cli.video.apart import DecodingProcess
    from oppload_cli.video.source import Video


def begin_opening(
    name: str,
    *,
    height: int | None,
    span: Span,
    image_rate: Fraction,
    threads: int,
    colour: bool,
    apart: DecodingProcess | None = None,
) -> Call[Video]:
    """Begin to open and decode an input, for a caller that has something else to do meanwhile.

    Parameters
    ----------
    name, height, span, image_rate, threads, colour
        As for :func:`oppload_cli.open_video`.
    apart : DecodingProcess, optional
        Decodes a video file; it is closed where it is of no use.

    Returns
    -------
    Call
        Its result is the video, or an error of :func:`oppload_cli.open_video`.
    """
    if apart is not None:
        # Pictures in colour are too large to be passed on.
        if _is_video_file(name) and not colour:
            apart.begin(name, height, span, threads)
        else:
            apart.close()
            apart = None

    def open_it() -> Video:
        # Not before: a process that decodes apart shall begin, and both load at once.
        from oppload_cli.video.source import Video, source_of  # noqa: PLC0415

        if apart is not None:
            return Video(apart.opened(), height, Span(), ahead=False)
        video = Video(source_of(name, image_rate, threads), height, span, colour=colour)
        video.begin()
        return video

    return Call(open_it)


def _is_video_file(name: str) -> bool:
    """Tell whether a name is that of a single file, and no image; any name will do."""
    return os.path.isfile(name) and os.path.splitext(name)[1].lower() not in IMAGE_SUFFIXES  # noqa: PTH113, PTH122
