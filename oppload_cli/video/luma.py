"""The luma of a decoded frame, in whatever format the decoder gives it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from av.video.frame import VideoFrame
    from numpy.typing import NDArray

LIMITED, FULL = 1, 2  # AVCOL_RANGE_MPEG, AVCOL_RANGE_JPEG
# Grey without a stated range: what a video codec codes is limited, all else is full.
LIMITED_GREY = {"h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mpeg2video", "prores"}
WITH_LUMA_PLANE = ("yuv", "gray", "nv", "p0", "p2", "p4")
PACKED_YUV = {"yuyv422", "uyvy422", "yvyu422"}
PACKED_RGB = {"bgr24": "BGR", "rgb24": "RGB", "bgra": "BGRA", "rgba": "RGBA"}


def luma_plane(frame: VideoFrame) -> tuple[NDArray[Any], int]:
    """Return the luma of a decoded frame, without a copy where it has a plane of its own.

    Parameters
    ----------
    frame : av.VideoFrame
        Any pixel format.

    Returns
    -------
    plane : ndarray of uint8 or uint16, shape (height, width)
        The Y plane; what has none (RGB, palettes) is converted to grey by the
        Rec. 601 weights.
    bits : int
        Bits that a sample uses.

    Raises
    ------
    ValueError, av.error.FFmpegError
        If it cannot be converted, as where damage has left an impossible colour space.
    """
    name = frame.format.name
    if name in PACKED_RGB:
        return _grey(frame.to_ndarray(), PACKED_RGB[name]), 8
    if name in PACKED_YUV:
        frame, name = frame.reformat(format="yuv422p"), "yuv422p"
    if not name.startswith(WITH_LUMA_PLANE) or name.startswith("grayf"):
        return _grey(frame.to_ndarray(format="bgr24"), "BGR"), 8
    # P010 and its kin hold their bits at the top of 16.
    bits = 16 if name.startswith("p") else frame.format.components[0].bits
    return _view(frame, bits, big_endian=name.endswith("be")), bits


def is_full_range(frame: VideoFrame, codec: str) -> bool:
    """Tell whether a frame's luma uses all of its range.

    Parameters
    ----------
    frame : av.VideoFrame
        A decoded frame.
    codec : str
        Name of its decoder, which settles grey frames that state no range.

    Returns
    -------
    bool
    """
    name = frame.format.name
    if name.startswith("yuvj") or not name.startswith(WITH_LUMA_PLANE):
        return name not in PACKED_YUV or frame.color_range == FULL
    if name.startswith("gray") and frame.color_range != LIMITED:
        return frame.color_range == FULL or codec not in LIMITED_GREY
    return bool(frame.color_range == FULL)


def _grey(colour: NDArray[Any], order: str) -> NDArray[np.uint8]:
    import cv2  # noqa: PLC0415 - most videos have a luma plane

    try:
        return np.asarray(cv2.cvtColor(colour, getattr(cv2, f"COLOR_{order}2GRAY")), np.uint8)
    except cv2.error as error:
        raise ValueError(str(error)) from error


def _view(frame: VideoFrame, bits: int, *, big_endian: bool) -> NDArray[Any]:
    plane = frame.planes[0]
    kind = np.dtype(np.uint8) if bits == 8 else np.dtype(">u2" if big_endian else "<u2")
    rows = np.frombuffer(memoryview(plane), kind).reshape(-1, plane.line_size // kind.itemsize)
    view: NDArray[Any] = rows[: frame.height, : frame.width]
    return view.astype(np.uint16) if big_endian and bits > 8 else view
