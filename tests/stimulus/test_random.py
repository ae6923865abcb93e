"""Random protocols: always a valid stimulus or a clear error, never a crash."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.objects import KINDS

if TYPE_CHECKING:
    from pathlib import Path

bounded = settings(
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def table(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """Build a TOML table; keys drawn as None are left out."""
    drawn = st.fixed_dictionaries(keys)
    return drawn.map(lambda made: {name: one for name, one in made.items() if one is not None})


# mostly within the ranges allowed, so that many protocols are valid
number = st.floats(0.5, 40) | st.floats(0.5, 40) | st.floats(0.5, 40) | st.floats(-5, 60)
share = st.floats(0, 0.5) | st.floats(0, 0.5) | st.floats(-0.1, 1.1)
point = st.lists(st.floats(-8, 8), min_size=2, max_size=2)
growth = st.one_of(
    table(
        kind=st.just("edge-speed"),
        speed_deg_s=number,
        end_deg=maybe(number),
        sides=maybe(st.sampled_from(["both", "forward", "backward"])),
    ),
    table(
        kind=st.just("approach"),
        l_over_v_ms=number,
        contact_s=st.sampled_from([None, None, None, 0.05, 0.5, 3.0]),
        most_deg=maybe(number),
    ),
    table(
        kind=st.just("steps"),
        sizes_deg=st.lists(number, min_size=2, max_size=3),
        times_s=st.just([0.0, 0.2]),
    ),
)
motion = table(
    speed_deg_s=maybe(number),
    direction_deg=maybe(st.floats(-400, 400)),
    rotation_deg_s=maybe(number),
    zoom_per_s=st.sampled_from([None] * 9 + [-3.0, 0.5]),
    shake_deg=maybe(st.floats(0, 5)),
    path_s=st.sampled_from([None, None, None, [0.0, 0.1], [0.2, 0.1]]),
    path_deg=st.lists(point, min_size=2, max_size=2),
).map(lambda made: made if "path_s" in made else {k: made[k] for k in made if k != "path_deg"})
brightness = table(kind=st.sampled_from(["step", "ramp"]), to=share) | table(
    kind=st.just("flicker"), to=share, frequency_hz=number
)
needs = {
    **{kind: {"size_deg": number} for kind in ("disk", "square", "patch")},
    **{kind: {"size_deg": number, "width_deg": number} for kind in ("bar", "cross", "ring")},
    **{kind: {"period_deg": number} for kind in ("square-grating", "sine-grating", "plaid")},
    "dots": {"dot_deg": st.floats(0.5, 8), "dots_per_100deg2": st.floats(0.1, 20)},
}
rarely = st.sampled_from([False] * 9 + [True])
stray = table(
    size_deg=maybe(number),
    width_deg=maybe(number),
    contrast=maybe(share),
    period_deg=maybe(number),
    dot_deg=maybe(st.floats(0.5, 8)),
    growth=maybe(growth),
)
common = table(
    luminance=maybe(share),
    axis_deg=maybe(st.floats(-400, 400)),
    centre_deg=maybe(point),
    onset_s=st.sampled_from([None, None, 0.05, 0.4]),
    reverse=maybe(st.booleans()),
    motion=maybe(motion),
    brightness=maybe(brightness),
)


@st.composite
def obj(draw: st.DrawFn) -> dict[str, Any]:
    """Draw an object with the keys that its kind needs, and now and then one that it refuses."""
    kind = draw(st.sampled_from(KINDS))
    made = {"kind": kind, **draw(common), **draw(table(**needs.get(kind, {})))}
    if "size_deg" in made and draw(st.booleans()):
        made["growth"] = draw(growth)
        if made["growth"]["kind"] == "approach":
            del made["size_deg"]
    return {**made, **draw(stray)} if draw(rarely) else made


protocol_table = table(
    seed=maybe(st.integers(0, 10)),
    display=table(
        width=st.integers(8, 40),
        height=st.integers(7, 40),
        frame_rate=st.sampled_from([None, 10, 29.97, "30000/1001", 60, None, 0]),
        field_of_view_deg=st.floats(10, 170) | st.floats(10, 200),
        projection=maybe(st.sampled_from(["flat", "perspective"])),
    ),
    timing=table(before_s=maybe(share), motion_s=st.floats(0.1, 0.6), after_s=maybe(share)),
    scene=maybe(table(rotation_deg=number, centre_deg=point, motion=maybe(motion))),
    effects=maybe(table(noise=maybe(share), shutter=maybe(share), invert=maybe(st.booleans()))),
    object=st.lists(obj(), min_size=1, max_size=2),
)
valid_kind = {
    "disk": {"size_deg": 5.0},
    "square": {"size_deg": 4.0},
    "bar": {"size_deg": 4.0, "width_deg": 2.0},
    "cross": {"size_deg": 6.0, "width_deg": 2.0},
    "ring": {"size_deg": 6.0, "width_deg": 2.0},
    "patch": {"size_deg": 6.0},
    "edge": {},
    "field": {},
    "square-grating": {"period_deg": 4.0},
    "sine-grating": {"period_deg": 4.0},
    "plaid": {"period_deg": 4.0},
    "texture": {"contrast": 0.3},
    "dots": {"dot_deg": 1.0, "dots_per_100deg2": 5.0},
}


def check(protocol: stimulus.Protocol) -> None:
    frames = list(stimulus.frames(protocol))
    assert len(frames) == protocol.frame_count
    for frame in frames:
        assert frame.luma.shape == (protocol.display.height, protocol.display.width)
        assert np.all((frame.luma >= 0) & (frame.luma <= 1))
    # strict: no NaN and no infinity in the file
    text = json.dumps(stimulus.ground_truth(protocol), allow_nan=False)
    assert stimulus.Protocol.from_table(json.loads(text)["protocol"], "again") == protocol


@pytest.mark.long
@bounded
@given(made=protocol_table)
def test_any_protocol_is_valid_or_refused(made: dict[str, Any]) -> None:
    for index, one in enumerate(made["object"]):
        one["id"] = f"obj-{index}"
    try:
        protocol = stimulus.Protocol.from_table(made, "random.toml")
    except StimulusError as problem:
        message = str(problem)
    else:
        message = "random.toml"
        check(protocol)
    assert message.startswith("random.toml")
    assert "\n" not in message


@pytest.mark.long
@bounded
@given(
    kind=st.sampled_from(sorted(valid_kind)),
    projection=st.sampled_from(["flat", "perspective"]),
    size=st.tuples(st.integers(8, 40), st.integers(8, 40)),
    motion_s=st.floats(0.05, 0.4),
    axis=st.floats(-400, 400),
    moved=table(
        speed_deg_s=st.floats(0, 60),
        direction_deg=maybe(st.floats(0, 360)),
        rotation_deg_s=st.floats(-200, 200),
        shake_deg=st.floats(0, 3),
    ),
    scene=table(rotation_deg=st.floats(-180, 180)),
    effects=table(shutter=st.sampled_from([0.0, 0.5]), noise=st.sampled_from([0.0, 0.1])),
    reverse=st.booleans(),
)
def test_valid_protocols_are_never_refused(  # noqa: PLR0917 - one argument per drawn value
    kind: str,
    projection: str,
    size: tuple[int, int],
    motion_s: float,
    axis: float,
    moved: dict[str, Any],
    scene: dict[str, Any],
    effects: dict[str, Any],
    reverse: bool,
) -> None:
    """Every combination of these is a stimulus: none is refused."""
    one = {"id": "obj", "kind": kind, "axis_deg": axis, "motion": moved, "reverse": reverse}
    one |= valid_kind[kind]
    if reverse and kind not in {"field", "edge"} and "size_deg" in valid_kind[kind]:
        one["motion"] = {**moved, "speed_deg_s": 0.0}
    made = {
        "display": {
            "width": size[0],
            "height": size[1],
            "field_of_view_deg": 60.0,
            "projection": projection,
        },
        "timing": {"motion_s": motion_s},
        "scene": scene,
        "effects": effects,
        "object": [one],
    }
    check(stimulus.Protocol.from_table(made, "random.toml"))


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    form=st.sampled_from(["ffv1", "npz", "gif"]), width=st.integers(8, 33), seed=st.integers(0, 9)
)
def test_random_sizes_make_valid_files(tmp_path: Path, form: str, width: int, seed: int) -> None:
    protocol = stimulus.load(
        "controls/static-texture",
        {"display.width": width, "display.height": 8, "timing.motion_s": 0.1, "seed": seed},
    )
    written = stimulus.write(protocol, tmp_path, form=form)
    assert written.video.stat().st_size > 0
    assert len(stimulus.read_ground_truth(written.truth)["frames"]) == 3


@pytest.mark.parametrize(
    "junk", ["", "=", "a = [", "[display]\nwidth = 1e400", "\x00", "a = 1\na = 2"]
)
def test_files_that_are_not_protocols(junk: str, tmp_path: Path) -> None:
    path = tmp_path / "junk.toml"
    path.write_text(junk)
    with pytest.raises(StimulusError, match=r"junk\.toml"):
        stimulus.load(path)
