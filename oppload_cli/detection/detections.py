"""From the objects that the units show to the detections of a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.detection.places import Places
from oppload_cli.models.opplod import Box
from oppload_cli.results.record import Detection

if TYPE_CHECKING:
    from oppload_cli.detection.parameters import PlaceParams
    from oppload_cli.detection.places import Track
    from oppload_cli.models.units import UnitMaps
    from oppload_cli.video.working import WorkingSize


class Detections:
    """OppLoD's looming objects in one video, in source pixels (``docs/places.md``).

    Parameters
    ----------
    maps : UnitMaps
        Of the model's judge.
    working : WorkingSize
        Size of the working frames, and its scale.
    params : PlaceParams, optional
        What is an object.
    """

    def __init__(
        self, maps: UnitMaps, working: WorkingSize, params: PlaceParams | None = None
    ) -> None:
        self._places = Places(maps, params)
        self._working = working
        self._cause: int | None = None

    def step(self, time_s: float, alarm: bool, threshold: float) -> tuple[Detection, ...]:
        """Find the objects of the frame that the judge has just seen.

        Parameters
        ----------
        time_s : float
            The frame's presentation time in seconds.
        alarm : bool
            Whether the model's alarm is on.
        threshold : float
            The response above which this frame sets it off.

        Returns
        -------
        tuple of Detection
            The largest response first. The alarm is that of the objects above the
            threshold, and of the one that was the largest when it went on.
        """
        tracks = self._places.step(time_s)
        if not alarm:
            self._cause = None
        elif self._cause is None and tracks:
            self._cause = tracks[0].identity
        return tuple(
            self._detection(
                track,
                alarm and (track.identity == self._cause or track.response > threshold),
            )
            for track in tracks
        )

    def _detection(self, track: Track, alarm: bool) -> Detection:
        scale_x, scale_y = self._working.scale_x, self._working.scale_y
        left = max(0.0, track.x - track.extent.x)
        top = max(0.0, track.y - track.extent.y)
        right = min(float(self._working.width), track.x + track.extent.x)
        bottom = min(float(self._working.height), track.y + track.extent.y)
        return Detection(
            track.identity,
            Box(left * scale_x, top * scale_y, (right - left) * scale_x, (bottom - top) * scale_y),
            track.x * scale_x,
            track.y * scale_y,
            track.response,
            alarm,
            track.time_to_contact_s,
        )
