"""One-second windows of a clip, and what is measured over them (``docs/evaluation.md``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from oppload_cli.detection.evaluation.series import Numbers, Seen

WINDOW_S = 1.0
LEAST_S = 0.5  # what remains of a clip counts as a window from here on
EPSILON_S = 1e-6  # times are fractions of a second that were rounded
AHEAD = (0, 4, 8, 12)  # frames before contact


class Window(NamedTuple):
    """Frames `start` to before `stop`."""

    start: int
    stop: int

    def score(self, response: Numbers) -> float:
        """Return the largest response within.

        Parameters
        ----------
        response : ndarray, shape (n,)
            Of the clip.

        Returns
        -------
        float
        """
        return float(response[self.start : self.stop].max())


def window_to(seen: Seen, stop: int, least: int) -> Window | None:
    """Return the window of one second that ends before a frame.

    Parameters
    ----------
    seen : Seen
        The clip.
    stop : int
        The frame after the window's last.
    least : int
        The earliest frame that it may hold.

    Returns
    -------
    Window or None
        None where under half a second is left.
    """
    if not least < stop <= len(seen):
        return None
    since = seen.time_s[stop - 1] - WINDOW_S + EPSILON_S
    start = max(least, int(np.searchsorted(seen.time_s, since, side="right")))
    if seen.seconds(start, stop) < LEAST_S - EPSILON_S:
        return None
    return Window(start, stop)


def tiled(seen: Seen, start: int, stop: int) -> list[Window]:
    """Return the windows that tile a part of a clip, from its end backwards.

    Parameters
    ----------
    seen : Seen
        The clip.
    start, stop : int
        First frame, and the one after the last.

    Returns
    -------
    list of Window
        The latest first; the earliest may be shorter, but has half a second.
    """
    made = []
    while (window := window_to(seen, stop, start)) is not None:
        made.append(window)
        stop = window.start
    return made


def before_contact(seen: Seen, frames: int = 0) -> Window | None:
    """Return the window that ends some frames before contact.

    Parameters
    ----------
    seen : Seen
        The clip.
    frames : int
        How many; 0 includes the frame of contact.

    Returns
    -------
    Window or None
        None without an approach, or where under half a second is clear of warm-up.
    """
    if seen.label.contact is None:
        return None
    return window_to(seen, seen.label.contact + 1 - frames, seen.first)


def without_approach(seen: Seen) -> list[Window]:
    """Return the windows of a clip in which nothing approaches.

    Parameters
    ----------
    seen : Seen
        The clip.

    Returns
    -------
    list of Window
        They share no frame with the last second before contact.
    """
    start, stop = seen.quiet
    last = before_contact(seen)
    return tiled(seen, start, min(stop, last.start) if last else stop)


def ordered_pairs(seen: Seen, contender: str, frames: int) -> tuple[float, int]:
    """Return the share of correctly ordered pairs within a clip.

    Parameters
    ----------
    seen : Seen
        The clip.
    contender : str
        Whose responses.
    frames : int
        How many frames before contact the approach's window ends.

    Returns
    -------
    share : float
        Of the clip's earlier windows, those whose largest response is below that of
        the approach's window; ties count half. NaN without a pair.
    pairs : int
        How many there are.
    """
    approach = before_contact(seen, frames)
    earlier = tiled(seen, seen.first, approach.start) if approach else []
    if approach is None or not earlier:
        return float("nan"), 0
    response = seen.answers[contender].response
    own = approach.score(response)
    scores = np.array([each.score(response) for each in earlier])
    return float(np.mean((scores < own) + 0.5 * (scores == own))), len(earlier)
