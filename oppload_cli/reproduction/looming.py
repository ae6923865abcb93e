"""Figures of the looming disk in the middle and off it, with the winning unit's field."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Rectangle

from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import png_bytes, styled_figure
from oppload_cli.reproduction.claims import (
    DPI,
    PRESETS,
    TITLES,
    WIDE,
    Built,
    Claim,
    Finding,
    Verdict,
    at_most,
    settings_of,
)
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.present import Responses

    Shown = dict[str, dict[str, Responses]]


_CENTRE, _OFF_CENTRE = "opplod2023/looming-disk-centre", "opplod2023/looming-disk-off-centre"
# The paper's field of 200 px, at the size at which the disk is drawn.
_FIELD = ("opplod.receptive_field=200", "opplod.cell=10")
_PAPER = {"opplod": 22, "dlgmd": 43}  # frame of the peak in the paper's figure
_EARLY = 0.1  # of the peak


def looming_centre() -> Built:
    """Show the disk in the middle of the field."""
    return _figure("looming-centre", "Looming disk in the middle of the field", _CENTRE)


def looming_off_centre() -> Built:
    """Show the disk off the middle."""
    return _figure("looming-off-centre", "Looming disk off the middle of the field", _OFF_CENTRE)


def _figure(name: str, title: str, stimulus: str) -> Built:
    protocol = load(stimulus)
    shown = {
        preset: present(protocol, settings_of(preset, _FIELD, height="native"))
        for preset in PRESETS
    }
    peak = "OppLoD's response peaks near frame 22."
    notes = [
        "The paper prints no size and no speed: radius 5 + 4 t px at 600 x 600, t in frames, is "
        "chosen here. Preset reference has its field set to the paper's 200 px.",
        "The peak comes when the edge of the disk leaves the receptive field, and D-LGMD sees the "
        "entire frame: an earlier peak is a statement about the size of the field. Figure "
        "'thresholds' compares at equal false alarms.",
    ]
    if stimulus == _OFF_CENTRE:
        peak = "Off the middle, OppLoD's peak comes as early as in it."
        notes.append("D-LGMD's curve turns where the disk first reaches the frame's border.")
    claims = (
        _peaks_near(shown, "opplod", peak),
        _peaks_near(shown, "dlgmd", "D-LGMD's response peaks near frame 43."),
        _earlier(shown),
        _found(protocol, shown),
    )
    return Built(
        name,
        title,
        "Both detectors' curves for both presets, and the field of the winning unit at its peak.",
        claims,
        png_bytes(_draw(protocol, shown), DPI),
        tuple(notes),
    )


def _frame_of_peak(responses: Responses) -> int:
    return int(responses.frame[responses.peak or 0])


def _peaks_near(shown: Shown, detector: str, statement: str) -> Claim:
    findings = {}
    for preset, each in shown.items():
        peak, paper = _frame_of_peak(each[detector]), _PAPER[detector]
        findings[preset] = Finding(
            f"{detector_named(detector).label} peaks at frame {peak}; "
            f"the paper's figure says {paper}.",
            at_most(abs(peak - paper), 1, 3),
            {"peak_frame": peak, "paper_frame": paper},
        )
    rule = "holds: within 1 frame of the paper's, in part: within 3"
    return Claim(statement, rule, findings)


def _earlier(shown: Shown) -> Claim:
    findings = {}
    for preset, each in shown.items():
        onset = {name: _onset(responses) for name, responses in each.items()}
        peak = {name: _frame_of_peak(responses) for name, responses in each.items()}
        first = sum(at["opplod"] < at["dlgmd"] for at in (onset, peak))
        findings[preset] = Finding(
            f"10 % of its own peak: OppLoD at frame {onset['opplod']}, D-LGMD at {onset['dlgmd']}; "
            f"peaks at {peak['opplod']} and {peak['dlgmd']}.",
            (Verdict.DOES_NOT, Verdict.IN_PART, Verdict.HOLDS)[first],
            {f"{name}_onset_frame": frame for name, frame in onset.items()},
        )
    return Claim(
        "OppLoD responds earlier than D-LGMD.",
        "holds: earlier both at 10 % of the own peak and at the peak; in part: at one of them",
        findings,
    )


def _onset(responses: Responses) -> int:
    peak = float(responses.response[responses.peak or 0])
    return int(responses.frame[int(np.argmax(responses.response >= _EARLY * peak))])


def _found(protocol: Protocol, shown: Shown) -> Claim:
    centre = _centre(protocol)
    findings = {}
    for preset, each in shown.items():
        responses = each["opplod"]
        away = float(np.hypot(*(responses.centre[responses.peak or 0] - centre)))
        findings[preset] = Finding(
            f"At the peak the winning unit is {away:.0f} px from the disk's centre.",
            at_most(away, 10, 50),
            {"distance_px": away},
        )
    return Claim(
        "The model finds where the object is looming.",
        "holds: the winning unit is within 10 px of the disk's centre, in part: within 50 px",
        findings,
    )


def _centre(protocol: Protocol) -> NDArray[np.float64]:
    """Return x and y of the disk's centre in pixels."""
    display = protocol.display
    right, up = protocol.objects[0].centre_deg
    x, y = display.width / 2 + right * display.scale, display.height / 2 - up * display.scale
    return np.array([x, y])


def _draw(protocol: Protocol, shown: Shown) -> Figure:
    renderer = Renderer(protocol)
    with styled_figure(WIDE, 4.3) as figure:
        axes = figure.subplots(2, 2, width_ratios=[2, 1])
        for (curves, still), (preset, each) in zip(axes, shown.items(), strict=True):
            for name, responses in each.items():
                peak, colour = responses.peak or 0, detector_named(name).colour
                over = responses.response[peak]
                label = f"{detector_named(name).label}, peak {over:.3g}"
                curves.plot(responses.frame, responses.response / over, color=colour, label=label)
                curves.plot(responses.frame[peak], 1, "o", mfc="none", mec=colour, clip_on=False)
            for name, frame in _PAPER.items():
                curves.axvline(frame, color=detector_named(name).colour, lw=0.8, linestyle=":")
            curves.set(title=TITLES[preset], xlabel="frame (dotted: the paper's peaks)")
            curves.set(ylabel="response / peak", ylim=(-0.03, 1.08))
            curves.legend(loc="upper left")
            responses = each["opplod"]
            frame = _frame_of_peak(responses)
            still.imshow(renderer.grey(frame), cmap="gray", vmin=-80, vmax=255)
            left, top, width, height = responses.box[responses.peak or 0]
            still.add_patch(Rectangle((left, top), width, height, fill=False, ec="red", lw=1.4))
            still.set_title(f"frame {frame}, winning field")
            still.set(xlabel="x (px)", ylabel="y (px)")
    return figure
