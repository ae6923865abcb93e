"""Several models over one video: what they share is computed once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError
from oppload_cli.models.convolution import MEMORY
from oppload_cli.models.dlgmd import Dlgmd, DlgmdResponse
from oppload_cli.models.layers import Dpc
from oppload_cli.models.opplod import Opplod, OpplodResponse
from oppload_cli.models.parameters import DlgmdParams, DpcParams, OpplodParams, axes_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.kernels import Map

    Model = Opplod | Dlgmd
    Response = OpplodResponse | DlgmdResponse


class ModelBank:
    """Models that see the same frames, in one pass.

    Models of equal DPC constants share P, E and I.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : sequence of OpplodParams or DlgmdParams
        One set per model, in the order of the answers.

    Raises
    ------
    ParameterError
        If no model is given.
    """

    def __init__(
        self, shape: tuple[int, int], params: Sequence[OpplodParams | DlgmdParams]
    ) -> None:
        if not params:
            raise ParameterError("no model is chosen; name at least one")
        axes = {each.dpc(): axes_of(each) for each in params if isinstance(each, OpplodParams)}
        self._layers: dict[DpcParams, Dpc] = {
            constants: Dpc(shape, constants, axes.get(constants, ()))
            for constants in dict.fromkeys(each.dpc() for each in params)
        }
        self.models: dict[str, Model] = {}
        for each in params:
            dpc = self._layers[each.dpc()]
            model: Model = (
                Opplod(shape, each, dpc=dpc)
                if isinstance(each, OpplodParams)
                else Dlgmd(shape, each, dpc=dpc)
            )
            self.models[model.name] = model

    @property
    def luma_change(self) -> float | None:
        """Mean of P(t) over the frame, 0 to 1; None on the first frame."""
        return next(iter(self._layers.values())).luma_change

    @property
    def memory(self) -> int:
        """How many frames back the models see."""
        strides = [each.params.strides for each in self.models.values() if isinstance(each, Opplod)]
        return MEMORY * max(strides, default=1)

    @property
    def photoreceptors(self) -> Map:
        """P(t), shape (height, width), 0 to 1; of no meaning on the first frame."""
        return next(iter(self._layers.values())).photoreceptors

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        for resettable in (*self._layers.values(), *self.models.values()):
            resettable.reset()

    def step(self, luma: Map) -> dict[str, Response | None]:
        """Take the next frame; every model answers to it.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.

        Returns
        -------
        dict of str to response or None
            By model name; None during warm-up, frames 0 to 2.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """
        ready = [dpc.step(luma) for dpc in self._layers.values()]
        for model in self.models.values():
            if isinstance(model, Opplod):
                model.see(luma)
        return {
            name: model.respond() if all(ready) else None for name, model in self.models.items()
        }

    def at_rest(self) -> dict[str, Response | None]:
        """Return every model's answer to a frame in which nothing changed.

        Returns
        -------
        dict of str to response
        """
        return {name: model.at_rest() for name, model in self.models.items()}
