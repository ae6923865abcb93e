"""The presynaptic sums S of one video, by whichever arithmetic runs here."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Map

    Live = NDArray[np.uint8]


class Layers(NamedTuple):
    """What S is made from: views that the next frame overwrites.

    Attributes
    ----------
    excitation : ndarray of float32, shape (height, width)
        E.
    inhibition : ndarray of float32, shape (height, width)
        I.
    directional : mapping of int to ndarray of float32, shape (height, width)
        ``J_phi = I_phi - I / 2``, by direction phi of an axis; that of the opposite
        pathway is ``-J_phi``.
    """

    excitation: Map
    inhibition: Map
    directional: Mapping[int, Map]


class Presynaptic(Protocol):
    """Computes S from the P of three frames (``docs/model.md``, sections 2 and 4).

    Attributes
    ----------
    presynaptic : ndarray of float32, shape (height, width)
        ``S = max(0, E - I)`` of D-LGMD.
    pathways : dict of int to ndarray of float32, shape (height, width)
        ``S_phi = max(0, E - I_phi)``, by direction phi in degrees.
    live : ndarray of uint8, shape (height, ...), or None
        For each `LANES` columns, 0 where all of them are 0; None where that is not known.
    """

    presynaptic: Map
    pathways: dict[int, Map]
    live: Live | None

    @property
    def photoreceptors(self) -> Map:
        """P(t), the latest map taken."""

    def reset(self) -> None:
        """Forget all maps."""

    def begin(self, luma: Map) -> None:
        """Keep L of the first frame."""

    def change(self, luma: Map) -> float:
        """Compute P(t) from L(t) and the L that was kept; return its mean.

        Nothing is taken yet: a frame may be refused.
        """

    def take(self, *, ready: bool) -> None:
        """Take what `change` has computed; compute the sums too if they are valid."""

    def layers(self) -> Layers:
        """Return what the sums of the latest map are made from."""
