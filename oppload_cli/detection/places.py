"""Looming objects: where they are, which is which, and when they touch (``docs/places.md``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from oppload_cli.detection.contact import Contact
from oppload_cli.detection.extent import Extent, Products
from oppload_cli.detection.parameters import PlaceParams
from oppload_cli.detection.peaks import focus, peaks

if TYPE_CHECKING:
    from oppload_cli.detection.peaks import Peak
    from oppload_cli.models.units import UnitMaps

NEAR = 0.25  # receptive fields: a focus that near to an object's is always its own
RESOLVED = 1.5  # spreads of the pooling: an object smaller than that has no size yet
GROWTH = 1.25  # from one frame to the next, shortly before contact


@dataclass(eq=False)
class Track:
    """One object over time, in working pixels.

    Attributes
    ----------
    identity : int
        From 1.
    row, column : int
        The unit at its focus.
    x, y : float
        Its focus.
    extent : Extent
        Its half sizes.
    response : float
        Of the latest frame that showed it.
    seen_s : float
        When that was.
    time_to_contact_s : float or None
        As estimated then.
    """

    identity: int
    row: int
    column: int
    x: float
    y: float
    extent: Extent
    response: float
    seen_s: float
    contact: Contact = field(repr=False)
    time_to_contact_s: float | None = None

    def holds(self, x: float, y: float, near: float) -> float | None:
        """Return how far off its focus a point of it is, 0 to 1; None for one outside."""
        reach_x, reach_y = (max(near, GROWTH * half) for half in (self.extent.x, self.extent.y))
        away = max(abs(x - self.x) / reach_x, abs(y - self.y) / reach_y)
        return away if away <= 1 else None


class Places:
    """The looming objects of one video, from one frame to the next.

    It knows only frames that have passed, and no more of them than the objects that
    are still there.

    Parameters
    ----------
    maps : UnitMaps
        Of the judge; read anew at every step.
    params : PlaceParams, optional
        Its parameters.
    """

    def __init__(self, maps: UnitMaps, params: PlaceParams | None = None) -> None:
        self._maps = maps
        self._params = params or PlaceParams()
        self._products = Products(maps) if maps.pathways else None
        self._tracks: list[Track] = []
        self._count = 0
        self._before_s: float | None = None

    def step(self, time_s: float) -> list[Track]:
        """Find the objects of the frame that the judge has just seen.

        Parameters
        ----------
        time_s : float
            The frame's presentation time in seconds.

        Returns
        -------
        list of Track
            Those that it shows, the largest response first; the first one holds the
            frame's winning unit.
        """
        oldest = time_s - self._params.gap_s
        if self._before_s is not None:
            oldest = min(oldest, self._before_s)
        self._tracks = [track for track in self._tracks if track.seen_s >= oldest]
        shown: list[Track] = []
        for peak in peaks(self._maps, self._params):
            track = self._owner(peak)
            if track is None:
                track = self._new(peak, time_s)
            elif track not in shown:
                self._follow(track, peak, time_s)
            if track and track not in shown:
                shown.append(track)
        self._before_s = time_s
        return shown

    def _owner(self, peak: Peak) -> Track | None:
        """Return the object that a peak belongs to."""
        x, y = self._maps.centres_x[peak.column], self._maps.centres_y[peak.row]
        near = NEAR * self._maps.field
        held = [(track.holds(x, y, near), track) for track in self._tracks]
        own = [(away, track.identity, track) for away, track in held if away is not None]
        return min(own)[2] if own else None

    def _new(self, peak: Peak, time_s: float) -> Track | None:
        half = self._maps.field / 2
        extent = self._measured(peak.row, peak.column, half, half)
        if extent is None:
            return None
        self._count += 1
        x, y = focus(self._maps, peak.row, peak.column)
        track = Track(
            self._count,
            peak.row,
            peak.column,
            x,
            y,
            extent,
            peak.response,
            time_s,
            Contact(self._params),
        )
        self._tracks.append(track)
        self._time(track, time_s)
        return track

    def _measured(self, row: int, column: int, x: float, y: float) -> Extent | None:
        if self._products is None:
            return Extent(self._maps.field / 2, self._maps.field / 2, 0.0, True)
        return self._products.extent(row, column, x, y)

    def _follow(self, track: Track, peak: Peak, time_s: float) -> None:
        """Take an object on to the latest frame."""
        row, column = peak.row, peak.column
        x, y = focus(self._maps, row, column)
        extent = self._measured(row, column, track.extent.x, track.extent.y)
        if self._products and max(abs(row - track.row), abs(column - track.column)) > 1:
            # An edge of an object larger than the field, or a new focus: where more moves apart.
            place = self._products.better_unit(track.row, track.column, track.extent)
            held = self._products.extent(*place, track.extent.x, track.extent.y)
            if held and (extent is None or held.opponency > extent.opponency):
                extent, (row, column) = held, place
                x, y = float(self._maps.centres_x[column]), float(self._maps.centres_y[row])
        track.row, track.column, track.x, track.y = row, column, x, y
        track.extent = extent or track.extent
        track.response, track.seen_s = peak.response, time_s
        self._time(track, time_s)

    def _time(self, track: Track, time_s: float) -> None:
        track.time_to_contact_s = None
        resolved = track.extent.size >= RESOLVED * self._maps.spread
        if resolved and not track.extent.limited:
            # What moves is seen where it was half a frame ago.
            lag = (time_s - self._before_s) / 2 if self._before_s is not None else 0.0
            track.contact.add(time_s - lag, track.extent.size)
            track.time_to_contact_s = track.contact.remaining(time_s)
