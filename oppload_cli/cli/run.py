"""``oppload run``: its options, and the start of decoding; ``cli.running`` does the rest."""

from __future__ import annotations

import tomllib
from contextlib import ExitStack
from fractions import Fraction
from typing import Any

import click

from oppload_cli.cli import options
from oppload_cli.errors import ParameterError, faults_at
from oppload_cli.files.reading import text_of
from oppload_cli.schema import parsed_fraction
from oppload_cli.video.frames import AUTO, parse_height, pixels_of
from oppload_cli.video.inputs import HIGHEST_RATE
from oppload_cli.video.opening import Opening, is_video_file
from oppload_cli.video.span import Position, Reading, Span, parse_position


@click.command()
@click.argument("inputs", nargs=-1, metavar="INPUT...")
@options.output(
    ".",
    "Folder of the results; '-' streams one input's CSV.  [default: this folder]",
    streams=True,
)
@options.settings()
@click.option("-r", "--recursive", is_flag=True, help="Search folders to any depth.")
@click.option(
    "--files-from",
    metavar="LIST|-",
    help="Read inputs from a list, a name per line.",
)
@click.option("-0", "--null", is_flag=True, help="The names of the list end in NUL.")
@options.jobs("inputs")
@click.option("--shard", metavar="I/N", help="Do only the I-th of N parts, for job arrays.")
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Run on this dask cluster: tcp://host:port or a scheduler file.",
)
@click.option("--dry-run", is_flag=True, help="Print the plan, and do nothing.")
@click.option("--start", metavar="POSITION", help="First frame: 12.5 (s), f300 or 00:01:02.5.")
@click.option("--end", metavar="POSITION", help="Stop before this position.")
@click.option("--duration", metavar="POSITION", help="Stop this long after the start.")
@click.option(
    "--image-rate",
    metavar="HZ",
    help="Frames/s of images, which state no rate.  [default: that of their ground truth, or 30]",
)
@click.option(
    "--true-rate",
    metavar="HZ",
    help="Frames/s that the camera took, of videos in slow motion.  [default: those of the file]",
)
@click.option(
    "--stream",
    type=click.IntRange(1),
    help="Number of the video stream in a file of several.  [default: the one that programs show]",
)
@click.option(
    "--annotate", is_flag=True, help="Write NAME.annotated.mp4 too: boxes, responses and alarms."
)
@click.option(
    "--report",
    "report_pages",
    is_flag=True,
    help="Write NAME.report.html too, a page with video and curves; see 'oppload report'.",
)
@click.option(
    "--boxes",
    type=click.Choice(["alarm", "all", "none"]),
    default="alarm",
    show_default=True,
    help="Boxes in the annotated video: of objects that cause an alarm, of all, or none.",
)
@options.if_exists("a result", skip=True)
@click.option(
    "--fail-on",
    type=click.Choice(["alarm", "no-alarm"]),
    help="End with exit code 5: alarm, if any input had an alarm; no-alarm, if any input had none.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
@click.option(
    "-v",
    "--verbose",
    is_flag=True,
    help="Also print the working size, and all remarks on many inputs.",
)
def run(
    inputs: tuple[str, ...],
    start: str | None,
    end: str | None,
    duration: str | None,
    image_rate: str | None,
    true_rate: str | None,
    stream: int | None,
    **others: Any,
) -> int:
    """Run looming detectors, by default OppLoD and D-LGMD, on videos, frame by frame.

    INPUT is a video file, a folder of videos or of images, a pattern such as
    'clips/*.mp4' or frames_%04d.png, a stack such as stack.npy or file.h5:/array,
    camera:0, or a stream's address. For each input,
    DIR gets NAME.frames.csv with a row per frame, NAME.detections.jsonl with a line
    per looming object and frame, and NAME.oppload.json with all settings, versions and
    facts about the input; NAME is the input's name without its suffix. For several
    inputs, DIR/alarms.csv lists the alarms, and DIR/failures.csv the inputs that fail.
    """
    own = options.RunOptions(**{name: others.pop(name) for name in options.RunOptions._fields})
    if not inputs and not own.files_from:
        raise click.UsageError("Missing argument 'INPUT...'; or give --files-from LIST")
    span = _span(start, end, duration)
    rates = _rate("--image-rate", image_rate), _rate("--true-rate", true_rate)
    reading = Reading(*rates, stream)
    opening = None
    with ExitStack() as stack:
        if len(inputs) == 1 and not (own.annotate or own.for_many or own.dry_run):
            opening = _begun(inputs[0], span, reading, others)
            if opening is not None:
                stack.callback(opening.close)
        # Imported now, so that another process decodes the video while the detectors are loaded.
        from oppload_cli.cli.running import run_inputs

        return run_inputs(inputs, own, others, span, reading, opening)


def _begun(name: str, span: Span, reading: Reading, settings: dict[str, Any]) -> Opening | None:
    """Begin to decode a single video file.

    Return None for other inputs, and for a wrong setting, which `resolve` refuses later.
    """
    if not is_video_file(name):
        return None
    try:
        content: dict[str, Any] = {}
        if settings["config"]:
            content = tomllib.loads(text_of(settings["config"]))
        pixels = pixels_of(parse_height(settings["height"] or content.get("height", AUTO)))
    except (OSError, ValueError, TypeError, ParameterError, RecursionError):
        return None
    return Opening(name, height=pixels, span=span, reading=reading, own_process=True)


def _span(start: str | None, end: str | None, duration: str | None) -> Span:
    """Return the part of each input; raise ParameterError if it has no frame."""
    span = Span(
        _position("--start", start), _position("--end", end), _position("--duration", duration)
    )
    begin, stop = span.start, span.end
    if begin is None or stop is None or (begin.frame is None) != (stop.frame is None):
        return span  # only the frame times of the input relate a frame number to a time
    if (stop.frame or stop.seconds or 0) <= (begin.frame or begin.seconds or 0):
        raise ParameterError(
            f"--end {end} is not after --start {start}; give a later end, or --duration for a "
            "length"
        )
    return span


def _position(option: str, text: str | None) -> Position | None:
    with faults_at(option):
        return None if text is None else parse_position(text)


def _rate(option: str, text: str | None) -> Fraction | None:
    if text is None:
        return None
    try:
        rate = parsed_fraction(text)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not Fraction(1, 1_000_000) <= rate <= HIGHEST_RATE:
        raise ParameterError(
            f"{option} must be a number above 0 such as 30 or 30000/1001, from 0.000001 to "
            f"{HIGHEST_RATE}, not '{text[:80]}'"
        )
    return rate
