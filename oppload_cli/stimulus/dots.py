"""Random dots: where they are at any time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.texture import generator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.stimulus.kinematics import Pose
    from oppload_cli.stimulus.objects import Object

    Floats = NDArray[np.float64]


MOST_DOTS = 1_000_000


class DotField:
    """Random dots in a square that repeats, larger than what the display shows of it.

    Parameters
    ----------
    thing : Object
        Of the kind ``dots``.
    seed : int
        Of the protocol.
    view_deg : float
        Diameter of the display, in degrees of the pattern, where it shows most of it.
    """

    def __init__(self, thing: Object, seed: int, view_deg: float) -> None:
        self.side = view_deg + 2 * (thing.dot_deg or 0.0)
        number = max(1, round((thing.dots_per_100deg2 or 0.0) / 100 * self.side**2))
        if number > MOST_DOTS:
            raise StimulusError(
                f"object '{thing.id}': dots_per_100deg2 = {thing.dots_per_100deg2:g} makes "
                f"{number} dots, and the most is {MOST_DOTS}; lower it, or its motion's zoom"
            )
        random = generator(seed, thing.id)
        self.places = random.uniform(-self.side / 2, self.side / 2, (number, 2))
        directions = random.uniform(0, 2 * math.pi, number)
        own = round((1 - thing.coherence) * number)
        self.headings = np.stack([np.cos(directions), np.sin(directions)], axis=1)[:own]

    def positions(self, pose: Pose) -> Floats:
        """Return the dots' positions in the field.

        Parameters
        ----------
        pose : Pose
            Of the pattern.

        Returns
        -------
        ndarray
            float64 (n, 2): degrees right and up.
        """
        angle = math.radians(pose.orientation_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        places = self.places.copy()
        own = len(self.headings)
        if own:
            # they go as far as the others, each in its own direction
            common = np.array(pose.travel_deg)
            places[:own] += (np.hypot(*common) * self.headings - common) @ turn / pose.zoom
        centre = np.array(pose.centre_deg)
        middle = -centre @ turn / pose.zoom
        places += self.side * np.round((middle - places) / self.side)
        return np.asarray(centre + pose.zoom * (places @ turn.T))
