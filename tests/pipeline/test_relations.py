"""Complete results of pictures that are mirrored, inverted, paler, larger, or after a cut.

Cells and windows fill these frames evenly, so that they are mirrored too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import oppload_cli as oppload
from tests.media import texture

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

HEIGHT, WIDTH = 120, 144
VERSIONS = ("opplod", "opplod_reference")
# The detectors for which darkening is the same as brightening.
BOTH_WAYS = ("dlgmd", "frame_difference", "ttc_gradient", "lgmd1_group", "lgmd_contrast")
FROM_FLOW = {
    *(
        "id",
        "x",
        "y",
        "width",
        "height",
        "time_to_contact_s",
        "time_to_contact_error_s",
        "contact_s",
    ),
    *("angular_width_deg", "angular_height_deg", "angular_size_deg", "angular_speed_deg_s"),
}


def approach(strength: float = 1.0) -> NDArray[np.float32]:
    """A dark disk and, later, a bright one grow beside the middle of a texture at rest."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    frames, ground = [], 0.4 + 0.2 * texture(HEIGHT, WIDTH, 3)
    for t in range(24):
        frame = ground
        disks = (53, 79, 2 + 2.1 * t, 0.0), (115, 37, 2.4 * t - 12, 1.0)
        for across, down, radius, level in disks:
            edge = np.clip(radius - np.hypot(x - across, y - down) + 0.5, 0, 1)
            frame = frame + edge * (level - frame)
        frames.append(0.5 + strength * (frame - 0.5))
    return np.asarray(frames, np.float32)


def result(frames: NDArray[Any], *models: str, **options: Any) -> oppload.Result:
    options = {"height": HEIGHT, "rmo": False, "fov": 60, **options}
    return oppload.run(np.ascontiguousarray(frames), models or ["opplod"], rate=30, **options)


def assert_same(found: pd.DataFrame, expected: pd.DataFrame, within: float = 1e-4) -> None:
    """Compare two tables; boxes and times to contact follow from the flow.

    Its search goes over the frame in one direction, so that they differ between a picture and its
    mirror image, and times may be known or not.
    """
    assert list(found.columns) == list(expected.columns)
    for name in map(str, expected.columns):
        one, other = (table[name].to_numpy(float) for table in (found, expected))
        most = within * float(np.nanmax(np.abs(other), initial=0))
        if name.removeprefix("opplod_").removeprefix("reference_") in FROM_FLOW:
            both = np.isfinite(one) & np.isfinite(other)
            assert abs(np.isfinite(one).sum() - np.isfinite(other).sum()) <= 2, name
            away = np.abs(one - other)[both]
            assert np.median(away) <= 0.05 * np.abs(other[both]).max(), name
        else:
            np.testing.assert_allclose(one, other, rtol=0, atol=most, err_msg=name)


def assert_alike(found: pd.DataFrame, expected: pd.DataFrame, within: float) -> None:
    """Compare the frames of `opplod`, whose responses and places follow from the flow."""
    responses = [table["opplod_response"].to_numpy(float) for table in (found, expected)]
    most = within * float(np.nanmax(responses[1]))
    np.testing.assert_allclose(responses[0], responses[1], rtol=0, atol=most)
    known = np.nan_to_num(responses[1]) > 0.1 * np.nanmax(responses[1])
    assert known.sum() > 5
    for name in ("opplod_x", "opplod_y", "opplod_width", "opplod_height"):
        away = (found[name] - expected[name])[known].abs()
        assert away.median() <= 4, name  # a sample of the flow
    own = [name for name in expected.columns if name.startswith("opplod")]
    assert_same(found.drop(columns=own), expected.drop(columns=own))


def mirrored(table: pd.DataFrame, prefix: str, x: str, width: str, side: int) -> pd.DataFrame:
    """Return a table with the places along one axis mirrored; `prefix` is a detector's or empty."""
    changed = {f"{prefix}{x}": side - table[f"{prefix}{x}"] - table[f"{prefix}{width}"]}
    angle = f"{prefix}{'azimuth' if x == 'x' else 'elevation'}_deg"
    for name, total in ((f"{prefix}unit_{x}", side), (f"{prefix}centre_{x}", side), (angle, 0)):
        if name in table:
            changed[name] = total - table[name]
    return table.assign(**changed)


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("axis", "x", "size"), [(2, "x", "width"), (1, "y", "height")])
def test_a_mirrored_video_has_a_mirrored_result(version: str, axis: int, x: str, size: str) -> None:
    frames = approach()
    names, both = [version, "ttc_gradient"], (np.flip(frames, axis), frames)
    found, expected = (result(shown, *names) for shown in both)
    table, side = expected.frames, frames.shape[axis]
    for name in names:
        table = mirrored(table, f"{name}_", x, size, side)
    assert expected.frames[[f"{version}_x", "ttc_gradient_x"]].notna().sum().min() > 5
    assert expected.detections["id"].nunique() > 1
    if version == "opplod":
        assert_alike(found.frames, table, 0.12)
        return
    assert_same(found.frames, table)
    assert_same(found.detections, mirrored(expected.detections, "", x, size, side))


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_dark_and_bright_count_alike(version: str) -> None:
    frames = approach()
    names = [version, *BOTH_WAYS]
    found, expected = (result(shown, *names) for shown in (1 - frames, frames))
    assert all(expected.frames[f"{name}_response"].max() > 0 for name in names)
    if version == "opplod":
        assert_alike(found.frames, expected.frames, 0.02)
        return
    assert_same(found.frames, expected.frames)
    assert_same(found.detections, expected.detections)


def test_half_the_contrast() -> None:
    """Products of S are squared; S itself is linear."""
    half, full = (
        result(approach(strength), "opplod_reference", "dlgmd").frames for strength in (0.5, 1.0)
    )
    for name, factor in (("opplod_reference_response", 2**4), ("dlgmd_s", 2), ("luma_change", 2)):
        assert full[name].max() > 0
        np.testing.assert_allclose(half[name] * factor, full[name], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_video_of_twice_the_size_has_boxes_of_twice_the_size(version: str) -> None:
    frames = np.asarray(np.round(255 * approach()), np.uint8)
    larger = frames.repeat(2, axis=1).repeat(2, axis=2)
    found, expected = (result(shown, version).detections for shown in (larger, frames))
    places = ["x", "y", "width", "height", "centre_x", "centre_y"]
    assert len(expected) > 5
    assert_same(found.assign(**{name: found[name] / 2 for name in places}), expected, 1e-9)


@pytest.mark.long
def test_a_cut_leaves_no_trace_in_later_responses() -> None:
    frames = approach()
    pan = np.asarray([np.roll(texture(HEIGHT, WIDTH, 8), 2 * t, 1) for t in range(20)])
    alone, after = (
        result(shown, "opplod_reference", *BOTH_WAYS[:2], rmo=True).frames[-21:]
        for shown in (frames, np.concatenate([pan, frames]))
    )
    columns = [
        name for name in alone.columns[2:] if "alarm" not in name and "threshold" not in name
    ]
    assert alone["opplod_reference_response"].max() > 0
    assert_same(after[columns], alone[columns], 1e-9)
