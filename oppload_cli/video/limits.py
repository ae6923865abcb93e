"""How large a picture may be, told before memory is taken for it."""

from __future__ import annotations

import os

from oppload_cli.errors import ParameterError, SourceError

DEFAULT_MOST_PIXELS = 1 << 26  # 8192 x 8192; a decoder keeps up to about 20 pictures
VARIABLE = "OPPLOAD_MAX_PIXELS"


def most_pixels() -> int:
    """Return how many pixels a source's picture may have.

    Returns
    -------
    int
        The environment's ``OPPLOAD_MAX_PIXELS``, or 2^26.

    Raises
    ------
    ParameterError
        If the variable is not a whole number from 1 to 2^31 - 1.
    """
    text = os.environ.get(VARIABLE, str(DEFAULT_MOST_PIXELS))
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and 1 <= int(text) < 1 << 31):
        raise ParameterError(
            f"{VARIABLE} must be a whole number from 1 to {(1 << 31) - 1}, not '{text}'"
        )
    return int(text)


def decoder_limit() -> str:
    """Return the value of FFmpeg's option ``max_pixels``.

    Decoders round sizes up and add margins before they compare, so they are given
    more than :func:`most_pixels`; it is the last defence, where a stream is larger
    than its container says.

    Returns
    -------
    str
    """
    return str(min(2 * most_pixels() + (1 << 16), (1 << 31) - 1))


def check_pixels(name: str, width: int, height: int) -> None:
    """Refuse a picture that is too large.

    A file of a few bytes may declare a picture that fills the memory.

    Parameters
    ----------
    name : str
        The file, for the message.
    width, height : int
        As it declares them, in pixels.

    Raises
    ------
    SourceError
        If there are more pixels than :func:`most_pixels`.
    """
    most = most_pixels()
    if width * height > most:
        raise SourceError(
            f"{name}: declares {width} x {height} pixels, more than {most}; "
            f"set {VARIABLE} higher if that is right"
        )
