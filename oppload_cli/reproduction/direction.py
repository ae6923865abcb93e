"""Figures of motion direction extracting: up and down, the diagonals, and inward motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.models.dpc import direction_mask, inhibition_kernels
from oppload_cli.models.opplod_reference import OpplodReferenceParams
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.plots.style import CYCLE, FAINT, SHADES, styled_figure
from oppload_cli.reproduction.claims import (
    PAPER,
    PAPER_DETECTORS,
    REFERENCE,
    WIDE,
    Built,
    Claim,
    ClaimVerdict,
    Finding,
    described_settings,
    faint_note,
    presented,
    settings_of,
)
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.truth import frame_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.present import Responses

    Shown = dict[str, Any]
    Inward = dict[str, dict[int, Responses]]  # by stimulus and axis


_BAR, _BLOCK = "opplod2023/expanding-bar-vertical", "opplod2023/approaching-block"
_SHOWN_FRAME = {_BAR: 24, _BLOCK: 34}
_SPEEDS = (1, 2, 3, 4, 6, 8, 10, 15)
_VERTICAL = {90: "upward", 270: "downward"}
_DIAGONALS = (45, 135, 225, 315)
# Pathways along 0 and 90 degrees instead of diagonals.
_CARDINAL = {f"{detector}.axes": 0 for detector in PAPER_DETECTORS}

_STIMULI = {
    "outward": "opplod2023/bar-10",
    "outward, inward at the periphery": "opplod2023/periphery-inhibition",
    "inward": "opplod2023/inward-motion",
}
_OUTWARD, _BOTH, _INWARD = _STIMULI
_ANGLES = [0, 45]
# A field of 60 degrees, as that of LPLC2: 8 px/deg at a height of 600, so 192 px at 240.
_FIELD_OF_60 = {f"{REFERENCE}.receptive_field": 192}
_FILTERS = {REFERENCE: -1, PAPER: 1}  # weight of inward motion in the filter of each detector


def up_and_down() -> Built:
    """Measure how well the pathways separate upward and downward motion of the expanding bar."""
    findings, shown, described = {}, {}, {}
    for detector in PAPER_DETECTORS:
        settings = settings_of(detector, _CARDINAL)
        described[detector] = described_settings(settings)
        leaks, shown[detector] = _wrong_sides(
            load(_BAR), settings, tuple(_VERTICAL), _SHOWN_FRAME[_BAR]
        )
        speed, wrong = _speed(load(_BAR), settings), float(leaks.mean(axis=0).max())
        findings[detector] = Finding(
            f"At the working size, an end of the bar moves {speed:.2g} px/frame. S of the pathway "
            f"of the opposite direction is {100 * wrong:.1f} % of S of the right pathway.",
            ClaimVerdict.at_most(wrong, 0.01, 0.1),
            {"speed_px_frame": speed, "wrong_over_right": wrong},
        )
    by_speed = {speed: _leak_at(speed) for speed in _SPEEDS}
    return Built.of(
        "up-down",
        [Claim.of("pathways-up-and-down", findings)],
        _draw_up_down(shown, by_speed),
        ({"speed_px_frame": speed, "wrong_over_right": leak} for speed, leak in by_speed.items()),
        settings=described,
        speed=_SPEEDS[-1],
        remains=100 * by_speed[_SPEEDS[-1]],
    )


def diagonals() -> Built:
    """Measure how well the pathways separate the four diagonals of the approaching block."""
    findings, shown, described = {}, {}, {}
    rows: list[dict[str, Any]] = []
    for detector in PAPER_DETECTORS:
        settings = settings_of(detector)
        described[detector] = described_settings(settings)
        leaks, shown[detector] = _wrong_sides(
            load(_BLOCK), settings, _DIAGONALS, _SHOWN_FRAME[_BLOCK]
        )
        shares = 1 / (1 + leaks)
        rows += [
            {
                "detector": detector, "moving_frame": number, "pathway_deg": phi,
                "share_on_side": share,
            }
            for number, in_frame in enumerate(shares, 1)
            for phi, share in zip(_DIAGONALS, in_frame, strict=True)
        ]  # fmt: skip
        share, last = float(shares.mean(axis=0).min()), float(shares[-1].min())
        findings[detector] = Finding(
            f"On average over the frames, {100 * share:.1f} % of the worst pathway's S lies on "
            f"the side of the block that moves in the pathway's direction; {100 * last:.1f} % in "
            "the last frame, which has the fastest motion.",
            ClaimVerdict.at_least(share, 0.95, 0.75),
            {"least_mean_share_on_side": share, "least_share_in_last_frame": last},
        )
    claims = [Claim.of("pathways-along-diagonals", findings)]
    return Built.of("diagonals", claims, _draw_diagonals(shown), rows, settings=described)


def _wrong_sides(
    protocol: Protocol, settings: Settings, directions: tuple[int, ...], shown_frame: int
) -> tuple[NDArray[np.float64], Shown]:
    """Return S on the wrong side divided by S on the right side, and the maps of one frame.

    The ratios have the shape (frames, directions). They leave out frames without S on a right side.
    """
    ratios: list[NDArray[np.float64]] = []
    shown: Shown = {}
    video = StimulusVideo(protocol, settings.pixels)
    (name,) = settings.models
    model = detector_named(name)(video.working.shape, settings.groups[name])
    right_side = {phi: _side(video.working.shape, phi) for phi in directions}
    wrong_side = {phi: _side(video.working.shape, phi + 180) for phi in directions}
    for frame in video:
        if model.step(frame.luma) is None:
            continue
        of_frame = model.maps  # computed at each access
        maps = {phi: of_frame[f"S_{phi}"] for phi in directions}
        right = [float(maps[phi][right_side[phi]].sum()) for phi in directions]
        wrong = [float(maps[phi][wrong_side[phi]].sum()) for phi in directions]
        if min(right) > 0:
            ratios.append(np.divide(wrong, right))
        if frame.index == shown_frame:
            shown = {"luma": frame.luma, "maps": {phi: s.copy() for phi, s in maps.items()}}
    return np.array(ratios), shown


def _side(shape: tuple[int, int], phi: int) -> NDArray[np.bool_]:
    """Return a mask of the half of the frame that lies from the centre in the direction phi."""
    rows, columns = np.indices(shape)
    x, y = columns - (shape[1] - 1) / 2, rows - (shape[0] - 1) / 2
    angle = np.deg2rad(phi)
    return np.asarray(x * np.cos(angle) - y * np.sin(angle) > 1e-6)


def _speed(protocol: Protocol, settings: Settings) -> float:
    """Return the speed of an end of the bar in px/frame of the working size."""
    speed = frame_truth(protocol, _SHOWN_FRAME[_BAR]).objects[0].edge_speed_px_frame
    return speed * (settings.pixels or protocol.display.height) / protocol.display.height


def _leak_at(speed: int) -> float:
    """Return the share of S that the wrong pathway keeps at a speed in px/frame."""
    small = {"display.width": 300, "display.height": 300, "timing.motion_s": 0.6}
    protocol = load(_BAR, {**small, "bar.growth.speed_deg_s": 3 * speed})
    settings = settings_of(REFERENCE, _CARDINAL, height="native")
    return float(_wrong_sides(protocol, settings, tuple(_VERTICAL), -1)[0].mean(axis=0).max())


def _draw_up_down(shown: dict[str, Shown], by_speed: dict[int, float]) -> Figure:
    params = OpplodReferenceParams()
    kernels = inhibition_kernels(params)
    with styled_figure(WIDE, 6.2) as figure:
        axes = figure.subplots(3, 3)
        for row, (detector, pictures) in zip(axes, shown.items(), strict=False):
            _picture(row[0], pictures["luma"], f"{detector}: frame {_SHOWN_FRAME[_BAR]}")
            for panel, (phi, name) in zip(row[1:], _VERTICAL.items(), strict=True):
                _map(panel, pictures["maps"][phi], f"S of the {name} pathway")
        for panel, (phi, name) in zip(axes[2], _VERTICAL.items(), strict=False):
            kernel = direction_mask(params, phi) * (kernels[0] + kernels[1])
            image = panel.imshow(kernel, cmap=SHADES, extent=(-6.5, 6.5, 6.5, -6.5))
            panel.set(title=f"inhibition kernel, {name} pathway", xlabel="x (px)", ylabel="y (px)")
            figure.colorbar(image, ax=panel, shrink=0.8, label="weight")
        panel = axes[2, 2]
        panel.plot(list(by_speed), [100 * leak for leak in by_speed.values()], "o-",
                   color=detector_named(REFERENCE).colour, markersize=3)  # fmt: skip
        panel.axhline(1, color=FAINT, lw=0.6, linestyle="--")
        panel.set(title="S of the wrong pathway", xlabel="speed (px/frame)",
                  ylabel="divided by that of the right one (%)")  # fmt: skip
    return figure


def _draw_diagonals(shown: dict[str, Shown]) -> Figure:
    with styled_figure(WIDE, 3.6) as figure:
        axes = figure.subplots(2, 5)
        for row, (detector, pictures) in zip(axes, shown.items(), strict=True):
            _picture(row[0], pictures["luma"], f"frame {_SHOWN_FRAME[_BLOCK]}")
            row[0].set_ylabel(detector)
            for panel, phi in zip(row[1:], _DIAGONALS, strict=True):
                _map(panel, pictures["maps"][phi], f"S, passes {phi}°")
    return figure


def _picture(axes: Axes, luma: Map, title: str) -> None:
    rows, columns = luma.shape  # the object is in the middle
    middle = luma[rows // 5 : -(rows // 5), columns // 5 : -(columns // 5)]
    axes.imshow(middle, cmap="gray", vmin=0, vmax=1)
    axes.set(title=title, xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(True)


def _map(axes: Axes, values: Map, title: str) -> None:
    _picture(axes, values, title)
    axes.images[0].set(cmap="gray_r", clim=(0, max(float(values.max()), 1e-9)))


def inward_motion() -> Built:
    """Measure how inward motion suppresses the response to outward motion."""
    shown = {detector: _shown(detector) for detector in PAPER_DETECTORS}
    inward = {detector: _inward(own, detector) for detector, own in shown.items()}
    suppression = {detector: _suppression(own, detector) for detector, own in shown.items()}
    claims = (
        Claim.of("inward-suppressed", inward),
        Claim.of("periphery-suppresses", suppression),
    )
    return Built.of(
        "inward",
        claims,
        _draw_inward(shown),
        (
            {
                "detector": detector, "stimulus": label, "axis_deg": axis, "time_s": time,
                "response": response,
            }
            for detector, own in shown.items()
            for label, by_axis in own.items()
            for axis, responses in by_axis.items()
            for time, response in zip(responses.time_s, responses.response, strict=True)
        ),
        settings={
            detector: described_settings(settings_of(detector, _FIELD_OF_60))
            for detector in PAPER_DETECTORS
        },
    )  # fmt: skip


def _shown(detector: str) -> Inward:
    settings = settings_of(detector, _FIELD_OF_60)
    shown: Inward = {}
    for label, name in _STIMULI.items():
        key = "bar.axis_deg" if label == _OUTWARD else "scene.rotation_deg"
        members = presented(name, settings, {key: _ANGLES})
        responses = (by_detector[detector] for by_detector in members.values())
        shown[label] = dict(zip(_ANGLES, responses, strict=True))
    return shown


def _inward(shown: Inward, detector: str) -> Finding:
    ratios = {
        angle: shown[_INWARD][angle].largest / shown[_OUTWARD][angle].largest for angle in _ANGLES
    }
    return Finding(
        f"Peak for inward motion divided by the peak for outward motion: {_stated(ratios)}.",
        ClaimVerdict.at_most(max(ratios.values()), 0.05, 0.25),
        {f"ratio_{angle}_deg": ratio for angle, ratio in ratios.items()},
        _faint(shown, detector),
    )


def _suppression(shown: Inward, detector: str) -> Finding:
    both, outward = (
        {angle: float(np.nanmean(shown[label][angle].response)) for angle in _ANGLES}
        for label in (_BOTH, _OUTWARD)
    )
    ratios = {angle: both[angle] / outward[angle] for angle in _ANGLES}
    holds = ClaimVerdict.at_most(max(ratios.values()), 0.5, np.inf)
    return Finding(
        f"Mean response with inward motion divided by that without it: {_stated(ratios)}.",
        holds if min(ratios.values()) <= 0.9 else ClaimVerdict.DOES_NOT,
        {f"mean_ratio_{angle}_deg": ratio for angle, ratio in ratios.items()},
        _faint(shown, detector),
    )


def _faint(shown: Inward, detector: str) -> str:
    settings = settings_of(detector)
    return faint_note(detector, shown[_OUTWARD].values(), settings, "to outward motion")


def _stated(ratios: dict[int, float]) -> str:
    return " and ".join(f"{100 * ratio:.3g} % along {at} degrees" for at, ratio in ratios.items())


def _draw_inward(shown: dict[str, Inward]) -> Figure:
    with styled_figure(WIDE, 4.8) as figure:
        axes = figure.subplots(2, 3, width_ratios=[1, 1, 0.72])
        for row, (detector, own) in zip(axes, shown.items(), strict=True):
            for panel, angle in zip(row, _ANGLES, strict=False):
                largest = max(own[label][angle].largest for label in _STIMULI) or 1.0
                for label, colour, dash in zip(_STIMULI, CYCLE, ("-", "--", "-."), strict=False):
                    responses = own[label][angle]
                    panel.plot(
                        responses.time_s, responses.response / largest, color=colour,
                        linestyle=dash, label=label,
                    )  # fmt: skip
                panel.set(title=f"{detector}, axis {angle}°", xlabel="time (s)")
                panel.set_ylim(-0.03, 1.08)
            row[0].set_ylabel("response / largest")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        for panel, (detector, weight) in zip(axes[:, 2], _FILTERS.items(), strict=True):
            _draw_filter(figure, panel, detector, weight)
    return figure


def _draw_filter(figure: Figure, panel: Axes, detector: str, weight: int) -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 101), np.linspace(1, -1, 101))
    along = x + y
    weights = np.where(np.abs(along) < 1e-9, 0, np.where(along > 0, 1, weight))
    image = panel.imshow(weights, extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-1.6, vmax=1.6)
    panel.set(title=f"filter of {detector}", xlabel="offset x / half field")
    panel.set_ylabel("offset y / half field")
    panel.annotate("passes 45°", (0.1, 0.15), fontsize=6)
    bar = figure.colorbar(image, ax=panel, ticks=[-1, 0, 1], shrink=0.8)
    bar.set_label("weight of $S_{45}S_{225}$")
    bar.ax.set_ylim(-1, 1)
