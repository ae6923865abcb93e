"""The same bytes at every run, finite numbers from any pixels, flat memory over long runs."""

from __future__ import annotations

import builtins
import csv
import gc
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import ticks
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Outputs, Task
from oppload_cli.stimulus import ground_truth, load_all
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture, WorkingSize
from oppload_cli.video.luminance import Luminance, luminance_table
from oppload_cli.video.optics import Optics
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Span, parse_position
from tests.assigned import assigned
from tests.cli import inside
from tests.cli.process import in_turn
from tests.media import grey_frames, looming, write_video

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from oppload_cli.pipeline.settings import Settings


def table(path: Path, folder: Path, *assignments: str, height: str = "60") -> bytes:
    folder.mkdir(exist_ok=True)
    csv_path = folder / f"{len(list(folder.iterdir()))}.csv"
    outputs = Outputs(csv_path, csv_path.with_suffix(".json"))
    run_task(Task(str(path), resolve(height=height, assignments=assigned(*assignments)), outputs))
    return csv_path.read_bytes()


@pytest.fixture(scope="module")
def loom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames = [(frame * 255).round().astype(np.uint8) for frame in looming(96, 60, 40, 12)]
    folder = tmp_path_factory.mktemp("loom")
    return write_video(folder / "loom.mp4", frames, codec="libx264", pixel_format="yuv420p")


@pytest.mark.long
def test_runs_with_any_number_of_threads_give_the_same_bytes(loom: Path, tmp_path: Path) -> None:
    threads = cv2.getNumThreads()
    seen = set()
    try:
        for number in (1, 2, 4, 8, 1, 2, 4, 8):
            cv2.setNumThreads(number)
            seen.add(table(loom, tmp_path / "out"))
    finally:
        cv2.setNumThreads(threads)
    assert len(seen) == 1


@pytest.mark.long
def test_another_process_gives_the_same_bytes(
    loom: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENCV_FOR_THREADS_NUM", "3")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    monkeypatch.setenv("PYTHONHASHSEED", "3")
    with (tmp_path / "output").open("wb") as output:
        in_turn(("run", loom, "-o", "-", "-q", "--height", "60"), stdout=output)
    assert (tmp_path / "output").read_bytes() == table(loom, tmp_path / "out")


@pytest.mark.long
def test_no_plain_sum_of_floats(
    loom: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It rounds in another way since Python 3.12: results would depend on the version."""
    plain, callers = sum, set()

    def spy(values: Iterable[Any], /, start: Any = 0) -> Any:
        values = list(values)
        if plain(type(each) is float for each in values) > 2:  # two are rounded once in any way
            callers.add(sys._getframe(1).f_globals["__name__"])
        return plain(values, start)

    monkeypatch.setattr(builtins, "sum", spy)
    assert inside.oppload("run", loom, "-o", tmp_path, "--model", "all").returncode == 0
    for name in ("staged/near-miss", "staged/braking"):
        ground_truth(load_all(name)[0])
    Optics.of_fov(400, 200, 90).between((0, 100), (400, 100))
    assert not {name for name in callers if name.startswith("oppload_cli.")}


def stripes(height: int, width: int, period: int) -> NDArray[np.uint8]:
    return np.tile(np.uint8(255) * (np.arange(width) // period % 2 == 0), (height, 1))


def flash(count: int) -> Iterator[NDArray[np.uint8]]:
    for index in range(count):
        yield np.full((48, 64), 255 if index == 6 else 0, np.uint8)


SCENES: dict[str, Iterable[NDArray[Any]]] = {
    "uniform": [np.full((48, 64), 77, np.uint8)] * 12,
    "black": [np.zeros((48, 64), np.uint8)] * 12,
    "saturated": [np.full((48, 64), 255, np.uint8)] * 12,
    "flash": list(flash(12)),
    "flicker": [np.full((48, 64), 255 * (t % 2), np.uint8) for t in range(12)],
    "stripes": [np.roll(stripes(48, 64, 4), t, 1) for t in range(12)],
    "duplicates": [frame for frame in grey_frames(4) for _ in range(3)],
    "noise": list(np.random.default_rng(3).integers(0, 256, (12, 48, 64), np.uint8)),
    "1 x 1": [np.full((1, 1), 20 * t, np.uint8) for t in range(12)],
    "2 x 2": [np.full((2, 2), 20 * t, np.uint8) for t in range(12)],
    "2 x 48": [np.full((48, 2), 20 * t, np.uint8) for t in range(12)],
    "64 x 1": [np.full((1, 64), 20 * t, np.uint8) for t in range(12)],
}


@pytest.mark.parametrize(
    "height", ["native", "100", pytest.param("8", marks=pytest.mark.slow), "1"]
)
@pytest.mark.parametrize("scene", SCENES)
def test_finite_numbers_from_any_pixels(tmp_path: Path, scene: str, height: str) -> None:
    if scene in {"64 x 1", "2 x 48"} and height == "100":
        height = "20"  # 1280 x 20 and 20 x 480 are large enough
    path = write_video(tmp_path / "a.avi", SCENES[scene])
    text = table(path, tmp_path / "out", height=height)
    rows = list(csv.DictReader(text.decode().splitlines()))
    assert len(rows) == 12
    cells = [cell for row in rows for cell in row.values() if cell]
    assert all(math.isfinite(float(cell)) for cell in cells)
    if scene in {"uniform", "black", "saturated"}:
        responses = [row[f"{model}_response"] for row in rows[3:] for model in ("opplod", "dlgmd")]
        assert {float(each) for each in responses} == {0.0}


@pytest.mark.long
def test_extreme_parameters_stay_finite(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", SCENES["noise"])
    largest = ["opplod.gain=1e9", "opplod.periphery=1000", "opplod.inhibition_strength=100"]
    smallest = ["opplod.receptive_field=2", "opplod.cell=1", "opplod.kernel_radius=1"]
    wide = ["opplod.kernel_radius=50", "dlgmd.kernel_radius=50", "dlgmd.group_size=100"]
    for assignments in (largest, smallest, wide):
        rows = csv.DictReader(table(path, tmp_path / "out", *assignments).decode().splitlines())
        assert all(math.isfinite(float(cell)) for row in rows for cell in row.values() if cell)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400", "NaN", "-1", "0x10", ""])
@pytest.mark.parametrize(
    "name", ["opplod.sigma_excitation", "dlgmd.threshold_limit", "alarm.factor", "rmo.sides"]
)
def test_a_value_that_is_no_number_is_refused(name: str, value: str) -> None:
    with pytest.raises(ParameterError):
        resolve(assignments={name: str(value)})


class Endless:
    """A source of frames made on the fly, through the same code as a file's."""

    def __init__(self, name: str, count: int) -> None:
        self.decode = DecodeFacts()
        self.stopping = False
        self._count = count
        self.facts = InputFacts(name, "container", 32, 24, None, count)
        generator = np.random.default_rng(1)
        self._planes = list(generator.integers(0, 256, (16, 24, 32), np.uint8))

    def pictures(self) -> Iterator[Picture]:
        for index in range(self._count):
            self.decode.decoded += 1
            yield Picture(index, ticks(index / 30), self._planes[index % 16])

    def finish(self) -> None:
        pass

    def close(self) -> None:
        pass


class Meter:
    """Notes the memory and the open files of this process as a run goes on."""

    def __init__(self, every: int) -> None:
        self._every = every
        self.memory_after_1000 = 1000 // every - 1
        self._frames = 0
        self.memory: list[int] = []
        self.files: list[int] = []

    def __call__(self, _record: object) -> None:
        self._frames += 1
        if self._frames % self._every == 0:
            gc.collect()
            self.memory.append(resident())
            self.files.append(len(os.listdir("/proc/self/fd")))  # noqa: PTH208


def resident() -> int:
    """Return the memory that this process has in use, in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def long_run(
    monkeypatch: pytest.MonkeyPatch, folder: Path, count: int, settings: Settings
) -> Meter:
    if sys.platform != "linux":
        pytest.skip("NOT MEASURED: no /proc here")
    monkeypatch.setattr("oppload_cli.video.source.source_of", lambda name, *_: Endless(name, count))
    meter = Meter(500)
    task = Task("endless", settings, Outputs(folder / "a.csv", folder / "a.json"))
    outcome = run_task(task, on_frame=meter)
    assert outcome.frames == count
    return meter


def check_flat(meter: Meter) -> None:
    memory = meter.memory[meter.memory_after_1000 :]
    growth = max(memory) - memory[0]
    sys.stdout.write(f"{growth / 1e6:.2f} MB more than after 1,000 frames\n")
    assert growth < 5_000_000
    assert len(set(meter.files)) == 1


@pytest.mark.long
def test_memory_stays_flat(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    quick = resolve(height="24", models=["dlgmd"], measure_rmo=False)
    check_flat(long_run(monkeypatch, tmp_path, 2_000, quick))


@pytest.mark.slow
def test_memory_stays_flat_over_a_hundred_thousand_frames(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    check_flat(long_run(monkeypatch, tmp_path, 100_000, resolve(height="24")))


@pytest.mark.slow
def test_memory_stays_flat_over_a_long_file(tmp_path: Path) -> None:
    frames = grey_frames(50, width=32, height=24) * 400
    path = write_video(tmp_path / "a.mp4", frames, codec="libx264", pixel_format="yuv420p")
    meter = Meter(1000)
    outputs = Outputs(tmp_path / "a.csv", tmp_path / "a.json")
    run_task(Task(str(path), resolve(height="24"), outputs), on_frame=meter)
    check_flat(meter)


def test_closing_on_the_long_way_to_the_start_joins_the_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import threading

    monkeypatch.setattr(
        "oppload_cli.video.source.source_of", lambda name, *_: Endless(name, 10**12)
    )
    before = threading.active_count()
    with open_video("endless", span=Span(start=parse_position("f1000000000"))) as video:
        iter(video)
        assert threading.active_count() == before + 1
    assert threading.active_count() == before


def test_many_inputs_leave_nothing_open(loom: Path, tmp_path: Path) -> None:
    import threading

    if not Path("/proc/self/fd").exists():
        pytest.skip("NOT MEASURED: no /proc here")
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(loom.read_bytes()[:900])
    counts = []
    for _ in range(30):
        with open_video(loom, height=24) as video:
            next(iter(video))  # left in the middle
        with pytest.raises(Exception, match=r"not a video|no frame"):
            open_video(broken)
        counts.append((len(os.listdir("/proc/self/fd")), threading.active_count()))  # noqa: PTH208
    assert len(set(counts)) == 1


@pytest.mark.parametrize("full", [True, False])
def test_luminance_stays_within_its_range(full: bool) -> None:
    for bits in (8, 10, 16):
        values = luminance_table(bits, full)
        assert values.min() == 0
        assert values.max() == 1
        assert np.isfinite(values).all()
    facts = InputFacts("a", "container", 3, 5, None, None)
    luminance = Luminance(WorkingSize.of(facts, 2))(Picture(0, 0, np.full((5, 3), 255, np.uint8)))
    assert luminance.max() <= 1
