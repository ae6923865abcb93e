"""OppLoD to the letter of the paper (Shuang et al., arXiv:2302.10284), equation by equation.

The functions stand in the order of the paper and have its names; each names its equation. The paper
leaves out constants and contradicts itself in places: ``docs/paper.md`` says what was chosen there,
and why. The paper's inhibitory filter for the periphery has no equation and is left out.

Symbols: ``(x, y)`` is a pixel, t a frame, theta the direction of the motion that a pathway passes,
in degrees, counter-clockwise, 0 = right. P, E, I and S are arrays of float32 with the shape of the
frame, at least 0. `p` holds P(t), P(t-1) and P(t-2). :mod:`oppload_cli.models.dpc` has the parts
that all OppLoD detectors and D-LGMD share; there D is M_phi, theta is phi, and alpha is a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oppload_cli.models import dpc
from oppload_cli.models.detector import AlarmRule, Detector, Response, UnitMaps, inner
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.units import check_grid, grid_of, unit_starts
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from oppload_cli.models.dpc import Kernel, Kernels, Map

_BOTH_ORDERS = 2  # S_theta with S_(theta+pi) rotated, and the other way round: the same products


# ---- A. Motion direction extracting (MDE) --------------------------------------------------


def mde(params: DpcParams, theta: float) -> Kernel:
    """Return ``D = 1 / (1 + exp(sqrt(2) d))``, eq. (mde), d being the offset along theta.

    It is the paper's ``D(x, y, theta - 135)``. Of these degrees 45 are due to ``x' + y'``, which
    points along a diagonal already, and 180 to the name: the paper's theta is the direction that is
    blocked, ours the one that passes, as the paper's text and figures have it. D multiplies the
    inhibition kernel; as a factor of the inhibition map it would have no direction selectivity.
    """
    return dpc.direction_mask(params, theta)


# ---- B. The neural model -------------------------------------------------------------------


def photoreceptor(luminance: Map, before: Map) -> Map:
    """Return ``P(t) = |L(t) - L(t - 1)|``, eq. (photoreceptor)."""
    return dpc.photoreceptors(luminance, before)


def layer_e(p: Sequence[Map], kernels: Kernels) -> Map:
    """Return ``E = P(t) * W_E``, eq. (E layer).

    W_E is G_sigmaE of eq. (kernel EI) minus the undelayed part of ``alpha W_I``, at least 0, and 0
    where tau is at least 1, as in the code of D-LGMD's authors.
    """
    return dpc.excitation(p, kernels)


def layer_i(p: Sequence[Map], kernels: Kernels) -> Map:
    """Return ``alpha I``, with ``I = P(t - tau) * W_I``, eq. (P layer).

    W_I is G_sigmaI of eq. (kernel EI), and contains alpha, the `inhibition_strength`. The latency
    tau, eq. (tau) with alpha as `latency_alpha`, grows from the middle of the kernel: there it is
    0 and belongs to W_E, around it 1 frame and further out 2, so that I is two convolutions.
    """
    return dpc.inhibition(p, kernels)


def layer_s(p: Sequence[Map], kernels: Kernels) -> Map:
    """Return ``S = ReLU(E - alpha I)``, eq. (original layer S); rounding cannot put it above E."""
    return dpc.rectified(layer_e(p, kernels), layer_i(p, kernels))


def layer_os(p: Sequence[Map], kernels: Kernels) -> dict[int, Map]:
    """Return ``S(theta) = ReLU(E - alpha I D(theta))``, eq. (layer OS), by theta.

    The kernels have the masks D of two axes; ``D(theta) + D(theta + 180) = 1`` gives the inhibition
    of the opposite direction. A run computes the same by the compiled `dpc.presynaptic_sums`.
    """
    e, i = layer_e(p, kernels), layer_i(p, kernels)
    s: dict[int, Map] = {}
    for theta in kernels.odd_masks:
        i_theta = dpc.directional_inhibition(p, kernels, theta)
        s[theta] = dpc.rectified(e, i_theta)
        s[theta + 180] = dpc.rectified(e, i - i_theta)
    return s


def opposing_motion(s: Mapping[int, Map], theta: int) -> Map:
    """Return ``S_theta S_(theta + pi)``, the integrand of eq. (OMJ), of one zone.

    S_(theta + pi) is rotated by 180 degrees about the middle of the zone, as the text says. The
    integral is a sum over the axes, which follows after screening and enhancing: the paper screens
    pixels "of opposing motion", and a pixel belongs to the motion along one axis.
    """
    return np.asarray(s[theta] * s[theta + 180][::-1, ::-1], np.float32)


def selected(product: Map, threshold: float) -> Map:
    """Return S_e, the products of the pixels that exceed "the set threshold", shape (n,)."""
    return product[product > threshold]


def enhanced(s_e: Map, c2: float) -> float:
    """Return the sum of ``S_E = S_e S_e c2``, eq. (layer SE), over the selected pixels."""
    values = s_e.astype(np.float64).ravel()
    return c2 * float(values @ values)


def zone_response(
    s: Mapping[int, Map], axes: Sequence[int], threshold: float, c2: float
) -> tuple[float, float]:
    """Return the sums of S_E and of S_e over one zone: OMJ, screening and enhancing.

    Parameters
    ----------
    s : mapping of int to ndarray of float32, shape (side, side)
        S(theta) in the zone, by theta.
    axes : sequence of int
        The directions theta of the two axes.
    threshold, c2 : float
        The threshold of products, and the constant of enhancing.
    """
    s_enhanced = s_selected = 0.0
    for theta in axes:
        s_e = selected(opposing_motion(s, theta), threshold)
        s_enhanced += _BOTH_ORDERS * enhanced(s_e, c2)
        s_selected += _BOTH_ORDERS * float(s_e.sum(dtype=np.float64))
    return s_enhanced, s_selected


# ---- Zones and units -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class OpplodPaperParams(DpcParams):
    """Parameters of the paper's OppLoD; it prints no threshold, and no value of c2.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodPaperParams().receptive_field
    200
    """

    receptive_field: int = parameter(
        200, "side of a zone, the square receptive field of a unit", unit="px", low=2, high=8192
    )
    units: str = parameter(
        "5x5", "grid of zones, each with one LPLC2 unit: columns x rows; they overlap"
    )
    axes: int = parameter(
        45,
        "first axis of opponency; the second is at a right angle; the paper's model has diagonals",
        unit="deg",
        choices=(0, 45),
    )
    threshold: float = parameter(
        0.0, "threshold of the products, T_o; smaller ones are noise", low=0, high=1e9
    )
    gain: float = parameter(1.0, "constant of enhancing, c2", low=0, high=1e9)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_grid(self._label("units"), self.units)

    @property
    def both_axes(self) -> tuple[int, int]:
        """The two axes of opponency in degrees, 90 apart."""
        return self.axes, self.axes + 90


@dataclass(frozen=True)
class OpplodPaperResponse(Response):
    """The response of the paper's OppLoD to one frame: the sum of S_E over all zones.

    Attributes
    ----------
    opponency : float
        The sum of S_e in the zone with the largest sum of S_E.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodPaperResponse(0.5).opponency
    0.0
    """

    opponency: float = inner(0.0, "", "sum of S_e in the winning zone")


class OpplodPaper(Detector):
    """The paper's OppLoD; arguments as :class:`~oppload_cli.models.detector.Detector`.

    The visual field is divided into zones, evenly spread and overlapping, each with one LPLC2 unit
    that judges opposing motion about the middle of its zone.

    Source: the OppLoD paper; ``docs/model.md``, sections 1, 2, 4 and 5; ``docs/paper.md``.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.OpplodPaper((600, 800))
    >>> model.units.responses.shape, model.units.centres_x.tolist()
    ((5, 5), [100.0, 250.0, 400.0, 550.0, 700.0])
    """

    name = "opplod_paper"
    label = "OppLoD paper"
    colour = "#5CC200"
    evaluated = False  # if no version of OppLoD is chosen, two are evaluated
    year = 2023
    reference = "Shuang et al., OppLoD, arXiv:2302.10284"
    answers_to = "opposite motion in a zone, outward or inward, exactly about its middle"
    made_for = "600 px high, 30 frames/s"
    cost_ms = 6.3
    meaning = "the paper's OppLoD to the letter: 25 units of 200 x 200 px, pixel by pixel"
    response_column = "", "sum of S_E over all zones; empty during warm-up"
    responses = OpplodPaperResponse
    parameters = OpplodPaperParams
    height = 600
    interval = "frame"
    alarm: ClassVar = AlarmRule(
        None, why_none="it responds to inward and outward motion alike, so that no threshold "
        "separates approach and retreat"
    )  # fmt: skip
    least_object: ClassVar = 1e-6, 0.01
    warm_up = 3  # S needs P now, one and two frames ago
    places = True

    params: OpplodPaperParams

    def __init__(
        self, shape: tuple[int, int], params: OpplodPaperParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._dpc = self.layers.dpc(self.params, self.params.both_axes)
        self._field = min(self.params.receptive_field, *self.shape)
        columns, rows = grid_of(self.params.units)
        self.tops = unit_starts(self.shape[0] - self._field, rows)
        self.lefts = unit_starts(self.shape[1] - self._field, columns)
        y, x = (np.array(starts) + self._field / 2 for starts in (self.tops, self.lefts))
        self._units = UnitMaps(np.zeros((rows, columns), np.float32), y, x, float(self._field))

    @property
    def units(self) -> UnitMaps:
        """The zones' units at the latest frame: the sum of S_E in each zone."""
        return self._units

    @property
    def maps(self) -> dict[str, Map]:
        """P, E, I, S and S_theta (``S_45`` ...) of the latest frame, shape (height, width)."""
        return self._dpc.layer.maps

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._dpc.reset()
        self._units.responses[:] = 0

    def step(self, luma: Map) -> OpplodPaperResponse | None:
        """Take the next frame; None for the first three frames."""
        if not self._dpc.step(luma):
            return None
        layer, params = self._dpc.layer, self.params  # P -> E, I -> S -> S(theta): the DPC layer
        s, share = layer.sums.pathways, layer.photoreceptors.share
        if share != 1:  # only if `time.interval` is set: S over an interval of another length
            s = {theta: values * np.float32(share) for theta, values in s.items()}

        def response_at(top: int, left: int) -> tuple[float, float]:
            zone = np.s_[top : top + self._field, left : left + self._field]
            in_zone = {theta: values[zone] for theta, values in s.items()}
            return zone_response(in_zone, params.both_axes, params.threshold, params.gain)

        sums = np.array([[response_at(top, left) for left in self.lefts] for top in self.tops])
        s_enhanced, s_e = sums[..., 0], sums[..., 1]
        self._units.responses[:] = s_enhanced
        row, column = divmod(int(s_enhanced.argmax()), s_enhanced.shape[1])
        response = float(s_enhanced.sum())
        box = self._units.box(row, column) if response else None
        return OpplodPaperResponse(response, box, float(s_e[row, column]))
