"""Untrusted settings, results and command lines only ever produce errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oppload_cli.cli import oppload
from oppload_cli.errors import OpploadError, ParameterError
from oppload_cli.pipeline.settings import Settings, resolve
from oppload_cli.plots.curves import plot_curves
from oppload_cli.results.result_files import read_result
from oppload_cli.video.inputs import each_once, result_stem
from oppload_cli.video.span import parse_position

BOUNDED = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
SCALARS = st.one_of(
    st.integers(),
    st.floats(),
    st.booleans(),
    st.text(max_size=8),
    st.sampled_from(["native", "paper", "opplod", "auto", "5x5", "every"]),
)
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3), max_leaves=5)
KEYS = st.sampled_from(
    ["preset", "models", "height", "measure_rmo", "opplod", "dlgmd", "alarm", "rmo", "repeats"]
)
NAMES = st.sampled_from(["gain", "units", "cell", "axes", "factor", "window", "most", "grid", "x"])


def toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value) if "e" not in repr(value) or "." in repr(value) else f"{value:.1e}"
    return json.dumps(value) if isinstance(value, str | int) else f"[{', '.join(map(toml, value))}]"


@pytest.mark.long
@BOUNDED
@given(
    top=st.dictionaries(KEYS, VALUES, max_size=3),
    tables=st.dictionaries(KEYS, st.dictionaries(NAMES, VALUES, max_size=3), max_size=3),
)
def test_settings_of_any_values(
    tmp_path: Path, top: dict[str, Any], tables: dict[str, dict[str, Any]]
) -> None:
    lines = [f"{key} = {toml(value)}" for key, value in top.items() if key not in tables]
    for key, values in tables.items():
        lines += [f"[{key}]", *(f"{name} = {toml(value)}" for name, value in values.items())]
    path = tmp_path / "s.toml"
    path.write_bytes("\n".join(lines).encode("utf-8", "surrogatepass"))
    try:
        found = resolve(config=path)
    except ParameterError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert isinstance(found, Settings)


@BOUNDED
@given(content=st.binary(max_size=300))
def test_settings_of_any_bytes(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(content)
    try:
        resolve(config=path)
    except OpploadError as error:
        assert "\n" not in str(error)  # noqa: PT017


def test_settings_and_sidecars_that_are_nested_without_end(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("models = " + "[" * 100_000)
    with pytest.raises(ParameterError, match="is not valid TOML"):
        resolve(config=path)
    csv = result(tmp_path, "frame,time_s,opplod_response\n0,0,1\n1,0.1,2\n")
    for content in ("[" * 100_000, '{"input": 3}', '{"input": {"name": 4}}', "[]", "\xff"):
        (tmp_path / "a.oppload.json").write_text(content)
        try:
            assert read_result(csv).title
        except OpploadError as error:
            assert "a.oppload.json: is not a sidecar" in str(error)  # noqa: PT017


def result(folder: Path, text: str) -> Path:
    path = folder / "a.frames.csv"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


CELLS = st.one_of(
    st.just(""),
    st.integers().map(str),
    st.floats().map(str),
    st.sampled_from(["nan", "inf", "-1", "1e999", '"', "a", "0x1", "1,2", "\x00", "\r", "⅓"]),
)
COLUMNS = st.sampled_from(
    ["frame", "time_s", "opplod_response", "dlgmd_response", "opplod_alarm", "rmo_index", "x", ""]
)


@BOUNDED
@given(
    header=st.lists(COLUMNS, min_size=1, max_size=7),
    rows=st.lists(st.lists(CELLS, max_size=7), max_size=5),
    end=st.sampled_from(["\n", "", "\r\n"]),
)
def test_results_of_any_cells(
    tmp_path: Path, header: list[str], rows: list[list[str]], end: str
) -> None:
    lines = [",".join(header), *(",".join(row) for row in rows)]
    path = result(tmp_path, "\n".join(lines) + end)
    try:
        found = read_result(path)
    except OpploadError as error:
        assert str(path) in str(error)  # noqa: PT017
    else:
        assert len(found.frames) >= 1


@BOUNDED
@given(content=st.binary(max_size=400))
def test_results_of_any_bytes(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.frames.csv"
    path.write_bytes(content)
    with pytest.raises(OpploadError):
        read_result(path)


@pytest.mark.parametrize("value", ["inf", "-inf", "1e308", "-5", "0"])
def test_results_with_strange_numbers_are_drawn_or_refused(tmp_path: Path, value: str) -> None:
    rows = "".join(f"{t},{t / 30},{value},1,0\n" for t in range(4))
    path = result(tmp_path, "frame,time_s,opplod_response,opplod_alarm,dlgmd_response\n" + rows)
    try:
        plot_curves(read_result(path))
    except OpploadError as error:
        assert str(path) in str(error)  # noqa: PT017


WORDS = st.sampled_from(
    [
        *("run", "plot", "config", "models", "info", "--set", "--model", "--height", "--preset"),
        *("-o", "--start", "f3", "0", "-1", "nan", "opplod.gain=2", "opplod", "native", "none.mp4"),
        *("--json", "--image-rate", "1/0", "--config", "-", "--", "", "ü", "--if-exists", "skip"),
        *("-q", "a\nb"),
    ]
)


@BOUNDED
@given(words=st.lists(WORDS, max_size=6))
def test_command_lines_of_any_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    """Nothing but an error that is meant; what would be a traceback is an exception here."""
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(oppload, words)
    assert done.exception is None or isinstance(done.exception, SystemExit | OpploadError), words


@BOUNDED
@given(text=st.text(max_size=12))
def test_positions_of_any_text(text: str) -> None:
    try:
        place = parse_position(text)
    except ParameterError as error:
        assert "is no position" in str(error)  # noqa: PT017
    else:
        assert (place.frame is None) != (place.seconds is None)


PARTS = st.text(st.characters(exclude_characters="\0", codec="utf-8"), min_size=1, max_size=40)


@BOUNDED
@given(names=st.lists(PARTS, max_size=6))
def test_no_result_leaves_its_folder(names: list[str]) -> None:
    hostile = [*names, "../../x.mp4", "/etc/passwd", "..", "a/../../b.avi", "rtsp://h/../../y?z"]
    stems = {name: result_stem(name) for name in hostile}
    for stem in map(stems.__getitem__, each_once(stems)):
        path = Path("/out") / f"{stem}.frames.csv"
        assert path.parent == Path("/out")
        assert ".." not in path.parts
