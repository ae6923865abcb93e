"""Writes the pages of results, the index of several pages, and the copies of videos.

A page plays a copy of its video: the frames of the result in H.264, which every browser plays, and
at most as large as the page shows them.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from importlib.resources import files
from itertools import chain, count
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

import cv2
import numpy as np
from av.video.reformatter import Colorspace

from oppload_cli.errors import OpploadError, OutputError, SourceError, printable
from oppload_cli.files.atomic import PartFile, make_folder, output_errors, write_atomic
from oppload_cli.files.html import embedded, rendered
from oppload_cli.frame_times import seconds_of
from oppload_cli.processes.pool import Seldom, outcomes
from oppload_cli.processes.threads import Call, Prefetch
from oppload_cli.report.content import Content, RelativeCurve
from oppload_cli.results.alarm_log import times
from oppload_cli.results.result_files import (
    find_video,
    frame_ends,
    read_result,
    stem_of,
    title_and_input,
)
from oppload_cli.results.table import PAGE
from oppload_cli.schema import is_integer
from oppload_cli.version import __version__
from oppload_cli.video.inputs import REPORTED
from oppload_cli.video.source import source_of, stop
from oppload_cli.video.span import Position, Reading, Span
from oppload_cli.video.writers import Colour, Recording, colour_size

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import av
    from numpy.typing import NDArray

    from oppload_cli.results.result_files import BaseResult, Series
    from oppload_cli.video.frames import InputFacts


_GENERATOR = f"oppload {__version__}"
_SPARK = (240, 48)  # width and height of a small curve in the index, in units of its drawing
MANY_FRAMES, SIDE_OF_MANY = 9000, 720  # longer videos have smaller copies, with sides up to 720 px
MOST_EMBEDDED = 16 << 20  # bytes; a larger copy is a file beside the page
_CODEC = {
    "preset": "superfast",
    "crf": "25",
    "bf": "0",
    "g": "15",  # a key frame every 15 frames, which the browser decodes for a step backwards
    # With look-ahead, the encoder sometimes gives other bytes for the same frames.
    "x264-params": "rc-lookahead=0:mbtree=0",
}


class _IndexRow(NamedTuple):
    title: str
    page: Path
    still: bytes  # JPEG; empty without a video
    sparks: list[tuple[str, str, str]]  # label, colour and SVG path of each curve
    # Label and colour of the detector, time in seconds, frame and peak of each alarm.
    alarms: list[tuple[str, str, float, int, float]]
    duration_s: float  # from the first frame to the end of the last one
    peak: float  # largest response divided by its threshold, or, without a threshold, by its peak
    thresholded: bool  # whether the peak is divided by a threshold
    reason: str  # why a peak above the threshold caused no alarm, or one below it did; else empty
    complete: bool  # whether the run read all of the video
    notes: list[str]  # remarks


@dataclass(frozen=True)
class _Report:
    """The files that :func:`write_report` has written."""

    pages: list[Path]  # in the order of the results
    index: Path | None  # None for a single result
    failures: list[OpploadError]  # one for each result without a page
    notes: list[str]  # about pages without a video, or with a video that may be another one

    @property
    def first(self) -> Path:
        """The page to open."""
        return self.index or self.pages[0]


class _PageTask(NamedTuple):
    """A page to write."""

    table: Path
    page: Path
    title: str
    videos: Path | None  # the video, or the folder of the videos, if they have moved
    index_path: Path | None


def write_report(
    tables: Sequence[Path],
    folder: Path,
    *,
    roots: Sequence[Path] | None = None,
    videos: Path | None = None,
    failed: Sequence[tuple[Path, str]] = (),
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> _Report:
    """Write a page for each of at least one result, and an index of several results.

    A result that cannot be read does not stop the others. The folder of the pages is made if it
    does not exist, and pages of the same name are replaced.

    Parameters
    ----------
    roots : sequence of Path, optional
        For each table, a folder above it. The place of the page below `folder` is the place of the
        table below its root. By default all pages lie in `folder` itself.
    videos : Path, optional
        The video, or the folder of the videos, if they have moved.
    failed : sequence of (Path, str)
        Inputs that failed: the folder and the stem of the result, and the error. The index lists
        the errors of those that have none of the results.
    progress : callable, optional
        Takes a count since its last call: of copied frames of video if there is a single result, of
        finished results if there are several.

    Raises
    ------
    OpploadError
        If no page could be made; the error is that of the first result.
    OutputError
        If the index cannot be written, or would replace an ``index.html`` of another program.
    """
    make_folder(folder)
    index = folder / "index.html" if len(tables) > 1 else None
    if index is not None:
        _refuse_other(index)
    pages = list(_page_names(tables, roots))
    items = [
        _PageTask(table, folder / page, title, videos, index)
        for table, page, title in zip(tables, pages, _titles(tables, pages), strict=True)
    ]
    by_position: dict[int, _IndexRow | OpploadError] = {}
    on_message = None if index else progress
    for position, outcome in outcomes(
        _write_page, items, jobs, named=lambda item: str(item.page), on_message=on_message
    ):
        by_position[position] = outcome
        if index and progress:
            progress(1)
    ordered = [by_position[position] for position in range(len(items))]
    entries = [entry for entry in ordered if isinstance(entry, _IndexRow)]
    failures = [failure for failure in ordered if isinstance(failure, OpploadError)]
    if not entries:
        raise failures[0]
    if index is not None:
        made = {table.parent / stem_of(table) for table in tables}
        missing = [*map(str, failures), *(error for stem, error in failed if stem not in made)]
        write_atomic(index, _index_page(index, entries, missing))
    notes = [f"{entry.page}: {note}" for entry in entries for note in entry.notes]
    return _Report([entry.page for entry in entries], index, failures, notes)


def _page_names(tables: Sequence[Path], roots: Sequence[Path] | None) -> Iterator[PurePosixPath]:
    """Yield the name of each page below their folder; a number keeps equal names different."""
    taken: set[PurePosixPath] = set()
    for table, root in zip(tables, roots or [table.parent for table in tables], strict=True):
        folder = PurePosixPath(table.parent.relative_to(root).as_posix())
        numbers = chain([""], (f"-{number}" for number in count(2)))
        names = (folder / f"{stem_of(table)}{number}{PAGE}" for number in numbers)
        name = next(name for name in names if name not in taken)
        taken.add(name)
        yield name


def _titles(tables: Sequence[Path], pages: Sequence[PurePosixPath]) -> Iterator[str]:
    """Yield the title of each page: the first of some names that no other result has.

    They are the input's file name, the same with the folder of the page, and the input's path. If
    all of them occur twice, the title is the page's own name.
    """
    candidates = [
        (title, str(page.parent / title), name)
        for page, (title, name) in zip(pages, map(title_and_input, tables), strict=True)
    ]
    counts = [Counter(names) for names in zip(*candidates, strict=True)]
    for page, names in zip(pages, candidates, strict=True):
        unique = [name for name, counter in zip(names, counts, strict=True) if counter[name] == 1]
        yield unique[0] if unique else str(page).removesuffix(PAGE)


def _refuse_other(index: Path) -> None:
    """Raise an OutputError if the file exists and another program has made it."""
    try:
        head = index.read_bytes()[:2000]
    except OSError:
        return  # the file does not exist, or writing it will raise the error
    if b'<meta name="generator" content="oppload ' not in head:
        raise OutputError(
            f"{index}: exists already and was not made by oppload; choose another --output"
        )


def _write_page(item: _PageTask, tell: Callable[[int], object]) -> _IndexRow:
    result = read_result(item.table)
    content = Content.of(result)
    path = item.page.with_name(item.page.name.removesuffix(PAGE) + REPORTED)
    copy: _VideoCopy | None = None
    try:
        name = find_video(result, item.videos)
        copy = _copy_video(result, name, path, still_row=content.strongest.best, tell=tell)
        video_notes = [copy.note] if copy.note else []
    except SourceError as error:
        video_notes = [f"the page has no video ({error})"]
    notes = [*content.notes, *video_notes]
    write_atomic(item.page, _result_page(item, content, copy, notes))
    strongest = content.strongest
    time_s = result.frames["time_s"].to_numpy(float)
    return _IndexRow(
        printable(item.title),
        item.page,
        copy.still if copy else b"",
        [(curve.label, curve.colour, _spark(curve, time_s)) for curve in content.curves],
        [
            (span.curve.label, span.curve.colour, span.start_s, span.frame, span.peak)
            for span in content.alarms
        ],
        float(frame_ends(time_s)[-1] - time_s[0]),
        strongest.peak,
        strongest.thresholded,
        content.reason.removeprefix(", which "),
        result.part("decode").get("complete") is not False,
        [*video_notes, *([result.shortfall] if result.shortfall else [])],
    )


def _result_page(
    item: _PageTask, content: Content, copy: _VideoCopy | None, notes: list[str]
) -> str:
    video = copy and {
        "times": [round(t, 7) if np.isfinite(t) else None for t in copy.times_s.tolist()],
        "address": None if copy.content is not None else _address(copy.path, copy.path),
        "name": printable(copy.path.name),
    }
    return rendered(
        "result.html",
        package=__package__,
        generator=_GENERATOR,
        policy=_policy(_script("uPlot"), _script("result")),
        chart=_script("uPlot"),
        script=_script("result"),
        style=_template("uplot", "uPlot.min.css"),
        data=content.data() | {"video": video},
        film=base64.b64encode(copy.content).decode("ascii") if copy and copy.content else "",
        title=printable(item.title),
        content=content,
        notes=[printable(note) for note in notes],
        index=_address(item.index_path, item.page) if item.index_path else None,
        seconds=_seconds,
        number=_number,
    )


def _index_page(index: Path, entries: Sequence[_IndexRow], failures: Sequence[str]) -> str:
    """Return the index as HTML: results with alarms come first, in the order of their peaks."""
    ordered = sorted(entries, key=lambda entry: (not entry.alarms, -entry.peak, entry.title))
    return rendered(
        "index.html",
        package=__package__,
        generator=_GENERATOR,
        policy=_policy(_script("index")),
        script=_script("index"),
        entries=ordered,
        alarmed=sum(bool(entry.alarms) for entry in entries),
        detectors=list(dict.fromkeys(spark[:2] for entry in ordered for spark in entry.sparks)),
        failures=[printable(failure) for failure in failures],
        spark_size=_SPARK,
        threshold_row=_spark_row(1.0),
        embedded=partial(embedded, kind="jpeg"),
        address=lambda path: _address(path, index),
        seconds=_seconds,
        number=_number,
    )


def _seconds(value: float) -> str:
    """Return a time as text: ``0.37 s``, or ``3:07.25`` for times of a minute or more."""
    value = round(value, 2)  # before the minutes are taken, so that no seconds are 60.00
    if value < 60:
        return f"{value:.2f} s"
    minutes, seconds = divmod(value, 60)
    return f"{int(minutes)}:{seconds:05.2f}"


def _number(value: float) -> str:
    """Return a multiple of a threshold as text, as `times` does, in the form of the page."""
    return f"{value:,.0f}" if value >= 10 else times(value).replace("<", "< ")


def _address(path: Path, page: Path) -> str:
    """Return the address of a file relative to a page, with special characters escaped."""
    relative = os.path.relpath(path, page.parent).replace(os.sep, "/")
    return "./" + quote(os.fsencode(relative))


def _spark(curve: RelativeCurve, time_s: Series) -> str:
    """Return a curve as an SVG path through the largest value of each bin of time."""
    known = np.flatnonzero(np.isfinite(curve.values))
    width = _SPARK[0]
    length = float(time_s[-1] - time_s[0]) or 1.0
    column = np.minimum(((time_s[known] - time_s[0]) / length * width).astype(int), width - 1)
    highest = np.zeros(width)
    np.maximum.at(highest, column, curve.values[known])
    points = (f"{x} {_spark_row(highest[x]):.1f}" for x in np.unique(column))
    return "M" + "L".join(points)


def _spark_row(value: float) -> float:
    """Return the vertical coordinate of a value on the logarithmic scale of a small curve."""
    low, high = -2.0, 2.0  # ends of the scale, in decades
    level = np.log10(value) if value > 0 else low
    share = (min(max(level, low), high) - low) / (high - low)
    return float(_SPARK[1] - 2 - (_SPARK[1] - 4) * share)


@cache
def _script(name: str) -> str:
    """Return a script of the pages; uPlot with the notice that its licence asks for."""
    if name != "uPlot":
        return _template(f"{name}.js")
    return f"/*\n{_template('uplot', 'LICENSE')}*/\n{_template('uplot', 'uPlot.iife.min.js')}"


def _template(*names: str) -> str:
    return files(__package__).joinpath("templates", *names).read_text("utf-8")


def _policy(*scripts: str) -> str:
    """Return a content security policy that allows these scripts and no network."""
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
        for script in scripts
    )
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data:; "
        f"media-src blob: file: 'self'; base-uri 'none'; form-action 'none'"
    )


# ---- The copy of a video ----------------------------------------------------------------------


@dataclass(frozen=True)
class _VideoCopy:
    path: Path  # of the copy, if it is a file beside the page
    times_s: NDArray[np.float64]  # of the frame of each row; NaN if the copy lacks the frame
    still: bytes  # the frame of one row as JPEG; empty if it was not decoded
    content: bytes | None  # the MP4; None if the copy is a file
    note: str  # a possible fault of the copy, as a sentence; else empty


def _copy_video(
    result: BaseResult, name: str, path: Path, *, still_row: int, tell: Callable[[int], object]
) -> _VideoCopy:
    """Encode the frames of a result from the video `name`.

    A copy that is too large to be embedded is the file `path`. The frame of `still_row` is also
    kept as a picture. A SourceError is raised if the video cannot be read, or contains none of the
    frames.
    """
    frames = result.frames["frame"].to_numpy(int)
    rows = {int(frame): row for row, frame in enumerate(frames)}
    span = Span(Position(frame=int(frames[0])), Position(frame=int(frames[-1]) + 1))
    times_s, picture = np.full(len(frames), np.nan), b""
    progress = Seldom(tell)
    source = Call(lambda: source_of(name, _reading(result))).result()
    size = _even_size(source.facts, len(frames))
    file = PartFile(path)
    ahead: Prefetch[tuple[int, float, av.VideoFrame]] | None = None
    try:
        recording = Recording(file, *size, source.facts.frame_rate, _CODEC)
        with output_errors(path), ExitStack() as on_failure:
            on_failure.callback(recording.abandon)
            colour = Colour(source.facts, size)
            ahead = Prefetch(
                (
                    (frame.index, seconds_of(frame.time), colour.planes(frame))
                    for frame in span.within(source)
                ),
                4,  # pictures wait to be encoded
            )
            for frame, time_s, planes in ahead:
                written_s = recording.write(planes, time_s)
                row = rows.get(frame)
                if row is not None:
                    times_s[row] = written_s
                    picture = _jpeg(planes) if row == still_row else picture
                progress(1)
            progress.flush()
            if np.isnan(times_s).all():
                raise SourceError(f"{name}: holds none of the frames of this result")
            recording.finish()
            on_failure.pop_all()
        content = None
        if file.raw.seek(0, os.SEEK_END) <= MOST_EMBEDDED:
            file.raw.seek(0)
            content = file.raw.read()
        else:
            file.commit()
    finally:
        stop(source, ahead)
        file.discard()
    note = _fault_of_video(result, name, source.facts, times_s)
    return _VideoCopy(path, times_s, picture, content, note)


def _even_size(facts: InputFacts, frames: int) -> tuple[int, int]:
    """Return the size of the copy; H.264 with halved colour planes has even sides only."""
    # 960 px are half the width of a screen, or the width of a phone's screen.
    longest = 960 if frames < MANY_FRAMES else SIDE_OF_MANY
    width, height = colour_size(facts, longest)
    return max(2, width - width % 2), max(2, height - height % 2)


def _reading(result: BaseResult) -> Reading:
    """Return the rate of the images, and the stream, that the result was made from."""
    facts = result.part("input")
    rate = None
    with suppress(KeyError, TypeError, ValueError, ZeroDivisionError):
        rate = Fraction(facts["frame_rate"])
    number = facts.get("video_stream")
    chosen = facts.get("video_streams", 1) != 1 and is_integer(number, 1)
    return Reading(rate, stream=number if chosen else None)


def _jpeg(frame: av.VideoFrame) -> bytes:
    """Return the picture for the index, with sides of at most 320 px."""
    colour = frame.to_ndarray(format="bgr24", src_colorspace=Colorspace.ITU709)
    scale = min(1.0, 320 / max(colour.shape[:2]))
    small = cv2.resize(colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return data.tobytes()


def _fault_of_video(
    result: BaseResult, name: str, facts: InputFacts, times_s: NDArray[np.float64]
) -> str:
    """Return a sentence if the video is not that of the run, or has lost frames; else nothing."""
    stated = result.part("input")
    for fact in ("bytes", "width", "height"):
        before, now = stated.get(fact), getattr(facts, fact)
        if before is not None and now != before:
            return (
                f"{name}: is not the video of the run ({fact} was {before}, is {now}); "
                f"boxes and curves may not fit this video"
            )
    lost = int(np.isnan(times_s).sum())
    return f"{name}: {lost} frames of the result could not be decoded again" if lost else ""
