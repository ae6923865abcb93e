"""Finds the inputs that a name on the command line means, and the names of their results."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
from collections import Counter
from contextlib import suppress
from fractions import Fraction
from numbers import Real
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.errors import ParameterError, SourceError, cannot_read, counted, without_login
from oppload_cli.files.reading import (
    NOT_IN_NAMES,
    fault_of_stem,
    is_file,
    is_folder,
    is_there,
    text_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence


_VIDEO_SUFFIXES = {
    *(".amv", ".avi", ".cine", ".flv", ".fmf", ".gif", ".seq", ".ufmf"),
    *(".h264", ".hevc", ".ivf", ".m2ts", ".m4v", ".mjpeg", ".mkv"),
    *(".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".nut", ".ogv", ".ts", ".webm"),
    *(".wmv", ".y4m"),
}
_ARRAYS = {".h5", ".hdf5", ".npz"}  # files that may hold several arrays, named as file.h5:/name
_STACKS = {*_ARRAYS, ".fmf", ".npy", ".seq", ".ufmf"}
IMAGE_SUFFIXES = {
    *(".bmp", ".jfif", ".jpe", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".pnm", ".ppm"),
    *(".tif", ".tiff", ".webp"),
}

NUMBER = re.compile(r"%0?([0-9]{0,3})d")  # the number in a pattern of image names
# Files with these endings are results, not inputs.
ANNOTATED, REPORTED = ".annotated.mp4", ".report.mp4"
GROUND_TRUTH = ".stimulus.json"  # end of the name of the file beside a stimulus's video
_REAL_TIME = ("rtsp:", "rtsps:", "rtp:", "srt:", "udp:", "rtmp:", "rtmps:")
_NUMBERED = re.compile(r"[0-9]\.[^.]+$")  # frame_0001.png
_LONGEST_STEM = 200  # bytes; a complete file name may have 255
_SHOWN = 3  # most names in a sentence
HIGHEST_RATE = 100_000  # frames/s


class _FoundInput(NamedTuple):
    """A single input, or the reason why a name is no input."""

    name: str
    error: SourceError | None = None
    # Where the results lie within the folder of all results: the way to the input from the folder
    # that the user named, or from the part of the user's pattern before its first wildcard.
    folder: str = ""


def found_inputs(name: str, *, recursive: bool = False) -> Iterator[_FoundInput]:
    """Yield the single inputs that a name means.

    The name is a file, a folder, a pattern of the shell (``clips/*.mp4``, with ``**`` for folders
    of any depth), a pattern of images, ``camera:0``, or an address. If `recursive` is True, folders
    are searched to any depth for videos and for folders of numbered images, except hidden folders
    and links to folders. A folder that cannot be read does not end the search.
    """
    if not name:
        yield _no_input("", "an empty name is no input; give a file or a folder")
        return
    matches = _matches(name)
    if not matches:
        yield _no_input(name, "matches no file; check the pattern")
    for match in matches:
        if recursive and is_folder(match):
            yield from _searched(match)
        elif match != name and _is_pipe_or_device(match):  # reading might never end
            reason = "is a pipe or a device, which patterns leave out; give its own name"
            yield _no_input(match, reason)
        else:
            try:
                folder = _below_fixed_part(name, match)
                yield from (_FoundInput(single, folder=folder) for single in _single_inputs(match))
            except SourceError as error:
                yield _FoundInput(match, error)


def _no_input(name: str, reason: str) -> _FoundInput:
    return _FoundInput(name, SourceError(f"{name or repr(name)}: {reason}"))


def _is_pipe_or_device(name: str) -> bool:
    return is_there(name) and not (is_file(name) or is_folder(name))


def _matches(name: str) -> list[str]:
    if not glob.has_magic(name) or is_address(name) or os.path.lexists(name):
        return [name]
    return sorted(glob.glob(name, recursive=True))  # noqa: PTH207 - absolute patterns too


def _below_fixed_part(pattern: str, match: str) -> str:
    """Return the way from the pattern's part before its first wildcard to the match's folder."""
    if pattern == match:
        return ""
    fixed = next(i for i, part in enumerate(Path(pattern).parts) if glob.has_magic(part))
    folders = Path(match).parts[fixed:-1]
    return "" if ".." in folders else str(Path(*folders))


def _searched(root: str) -> Iterator[_FoundInput]:
    errors: list[OSError] = []
    empty = True
    for folder, names, images in _walked(root, errors.append):
        paths = [os.path.join(folder, name) for name in names]  # noqa: PTH118
        # Without pipes, for which the batch would wait; the run of a broken link fails.
        videos = [path for path in paths if not _is_pipe_or_device(path)]
        if videos:
            subfolder = os.path.relpath(folder, root)
            yield from (_FoundInput(video, folder=subfolder) for video in videos)
        elif images:
            parent = "" if folder == root else os.path.relpath(os.path.dirname(folder), root)  # noqa: PTH120
            yield _FoundInput(folder, folder=parent)
        empty = empty and not videos and not images
    for error in errors:
        yield _FoundInput(str(error.filename), cannot_read(error.filename, error))
    if empty and not errors:
        reason = "no video and no numbered images in this folder or below; check the path"
        yield _no_input(root, reason)


def _walked(
    root: str, on_error: Callable[[OSError], object] | None = None
) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield each folder from `root` on, with the names of its videos and its numbered images."""
    for folder, subfolders, files in os.walk(root, onerror=on_error):
        subfolders[:] = sorted(
            subfolder for subfolder in subfolders if not subfolder.startswith(".")
        )
        yield folder, *_inputs_of(files)


def left_out(name: str, *, recursive: bool = False) -> Iterator[str]:
    """Yield sentences on inputs in a folder that `found_inputs` leaves out.

    These inputs are images beside videos and, without `recursive`, folders with inputs. An image
    whose name begins with that of a video is a figure of the video, not an input.
    """
    if not name:  # no input at all, though a path takes it for this folder
        return
    if recursive:
        mixed = [
            os.path.relpath(folder, name)
            for folder, videos, images in _walked(name)
            if videos and _without_figures(images, videos)
        ]
        if mixed:
            yield (
                f"{name}: {_listed(mixed, 'folder')} read without the numbered images that lie "
                "beside videos; give the images a folder of their own"
            )
        return
    try:
        entries = sorted(entry for entry in Path(name).iterdir() if not entry.name.startswith("."))
        folders = [
            entry.name
            for entry in entries
            if entry.is_dir()
            and not entry.is_symlink()
            and any(_inputs_of(file.name for file in entry.iterdir()))
        ]
    except (OSError, ValueError):  # no folder, or one that cannot be read: a run reports that
        return
    if folders:
        yield f"{name}: {_listed(folders, 'folder')} left out; --recursive runs the inputs there"
    videos = [entry.name for entry in entries if is_video(entry.name)]
    images = [entry.name for entry in entries if _suffix(entry.name) in IMAGE_SUFFIXES]
    images = _without_figures(images, videos)
    if videos and images:
        yield (
            f"{name}: {_listed(images, 'image')} left out beside videos; give a folder of images "
            "alone, or convert an animation to a video"
        )


def _without_figures(images: list[str], videos: list[str]) -> list[str]:
    stems = tuple(f"{PurePath(video).stem}." for video in videos)
    return [image for image in images if not image.startswith(stems)]


def _listed(names: list[str], kind: str) -> str:
    count = len(names)
    shown = ", ".join(names[:_SHOWN]) + ", ..." * (count > _SHOWN)
    return f"{counted(count, kind)} ({shown}) {'are' if count > 1 else 'is'}"


def _inputs_of(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the videos, and the images of a numbered sequence, among the names of files."""
    visible = sorted(name for name in names if not name.startswith("."))
    images = [e for e in visible if _suffix(e) in IMAGE_SUFFIXES and _NUMBERED.search(e)]
    # A single image, such as a figure, is no sequence.
    return [name for name in visible if is_video(name)], images if len(images) > 1 else []


def is_video(name: str) -> bool:
    """Return whether a file is a video by its name, and not a result of oppload."""
    return _suffix(name) in _VIDEO_SUFFIXES and not name.endswith((ANNOTATED, REPORTED))


def is_camera(name: str) -> bool:
    """Return whether a name means a camera; a file of the name camera:0 is written ./camera:0."""
    number = name.removeprefix("camera:")
    return number != name and (number.isdigit() or not is_there(name))


def is_address(name: str) -> bool:
    """Return whether a name is an address, such as ``rtsp://host/stream``: no path."""
    return "://" in name


def is_camera_or_stream(name: str) -> bool:
    """Return whether a name means a camera or is an address."""
    return is_address(name) or is_camera(name)


def is_real_time(name: str) -> bool:
    """Return whether a name means a camera or a stream that goes on, whether or not it is read."""
    return is_camera(name) or name.lower().startswith(_REAL_TIME)


def is_image_file(name: str) -> bool:
    """Return whether a name is that of a single image file."""
    return _suffix(name) in IMAGE_SUFFIXES and is_file(name)


def is_stack(name: str) -> bool:
    """Return whether a name is that of a file of arrays, or of a laboratory's video."""
    file, _ = stack_and_key(name)
    return _suffix(file) in _STACKS and is_file(file)


def stack_and_key(name: str) -> tuple[str, str]:
    """Return the file and the array of a name such as ``file.h5:/name``; the array may be empty."""
    file, _, key = name.rpartition(":/")
    return (file, key) if _suffix(file) in _ARRAYS else (name, "")


def _suffix(name: str) -> str:
    return os.path.splitext(name)[1].lower()  # noqa: PTH122 - many times faster than a Path


def _single_inputs(name: str) -> list[str]:
    """Return the videos of a folder, sorted by name; for any other name, the name itself.

    Raises SourceError if a folder has neither videos nor images, or cannot be listed.
    """
    path = Path(name)
    try:
        if not is_folder(name):
            return [name]
        # Some systems put a hidden file with the same suffix beside each video.
        visible = sorted(str(file) for file in path.iterdir() if not file.name.startswith("."))
    except OSError as error:
        raise cannot_read(name, error) from error
    files = [file for file in visible if not (is_folder(file) or _is_pipe_or_device(file))]
    videos = list(filter(is_video, files))
    if not videos and not any(_suffix(file) in IMAGE_SUFFIXES for file in files):
        raise SourceError(f"{name}: {_nothing_in(files)}")
    return videos or [name]


def _nothing_in(files: Sequence[str]) -> str:
    """Return what a folder without videos and images holds, and what to do."""
    if not files:
        return "no video and no image in this folder; check the path"
    suffix, count = Counter(_suffix(file) for file in files).most_common(1)[0]
    held = f"{counted(count, 'file')} {suffix or 'without a suffix'}"
    if suffix in _STACKS:
        return f"no video and no image in this folder, but {held}; give these by name"
    return (
        f"no video and no image that can be read in this folder, but {held}; convert pictures to "
        "PNG or TIFF, or check the path"
    )


def image_paths(name: str) -> list[Path]:
    """Return the images of a folder or a pattern, in the order of their numbers.

    Raises SourceError if no image exists. A pattern has one ``%d`` or ``%04d`` in its file name.
    """
    # Some systems put a hidden file with the same suffix beside each image.
    folder, accepted = Path(name), re.compile(r"[^.].*", re.DOTALL)
    number = NUMBER.search(folder.name)
    if number and not is_there(folder):
        before, after = folder.name[: number.start()], folder.name[number.end() :]
        digits = f"[0-9]{{{number[1]},}}" if number[1] else "[0-9]+"
        accepted = re.compile(re.escape(before) + digits + re.escape(after))
        folder = folder.parent
    try:
        paths = [
            path
            for path in folder.iterdir()
            if path.suffix.lower() in IMAGE_SUFFIXES and accepted.fullmatch(path.name)
        ]
    except (FileNotFoundError, NotADirectoryError) as error:
        raise SourceError(f"{name}: no such folder; check the path") from error
    except OSError as error:
        raise cannot_read(name, error) from error
    if not paths:
        raise SourceError(f"{name}: no image there; give a folder or a pattern of images")
    return sorted(paths, key=_numerical_order)


def _numerical_order(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Return a key that sorts ``f2`` before ``f10``."""
    parts = re.split(r"([0-9]+)", path.name)  # text, number, text, ...
    order = [(int(part), "") if index % 2 else (-1, part) for index, part in enumerate(parts)]
    return order, path.name


def is_missing(name: str) -> bool:
    """Return whether a name means a file, a folder or images that do not exist."""
    if is_camera_or_stream(name) or is_there(stack_and_key(name)[0]):
        return False
    try:
        return not (NUMBER.search(Path(name).name) and image_paths(name))
    except SourceError:
        return True


def bytes_of(name: str) -> int | None:
    """Return the size of a file, or of all images of a sequence; None for any other input."""
    try:
        single = stack_and_key(name)[0]
        files = [Path(single)] if is_file(single) else image_paths(name)
    except SourceError:
        return None
    total = 0
    for file in files:
        with suppress(OSError):  # a broken link, or an image that was just removed
            total += file.stat().st_size
    return total


def truth_beside(name: str | Path) -> Path:
    """Return the path of an input's ground truth, which may not exist."""
    path, folder = Path(name), is_folder(name)
    if not folder and NUMBER.search(path.name) and not is_there(name):
        path, folder = path.parent, True  # a pattern of the images in a folder
    if folder and path.name in {"", ".."}:  # such as ".": its own name is in its complete path
        path = path.absolute().resolve()
    # The name of a folder may have a dot, as in `disk_l-over-v-2.5`, but has no suffix.
    return path.parent / f"{path.name if folder else path.stem}{GROUND_TRUTH}"


def without_truths(names: Sequence[str]) -> list[str]:
    """Return inputs without the ground truths of others among them: ``folder/*`` names both."""
    truths = {str(truth_beside(name)) for name in names}
    return [name for name in names if os.path.normpath(name) not in truths]


def checked_rate(rate: float | Fraction | None, name: str = "rate") -> Fraction | None:
    """Return frames per second as a fraction; None if they are not known.

    Raises ParameterError, with the `name` of the rate, unless it is a number above 0 and at most
    100000.
    """
    if rate is None:
        return None
    given: object = rate  # a caller may give a text, in spite of the type
    if not isinstance(given, Real) or not 0 < rate <= HIGHEST_RATE:
        raise ParameterError(
            f"{name} must be a number above 0 and at most {HIGHEST_RATE} frames/s, not {rate!r}"
        )
    exact = rate if isinstance(rate, Fraction) else Fraction(float(rate))
    return exact.limit_denominator(1 << 16) or exact  # a rate below 1 / 2^17 would become 0


def rate_beside(name: str) -> Fraction | None:
    """Return the frames per second that the ground truth of images states; None if none does."""
    try:
        rate = Fraction(json.loads(text_of(truth_beside(name)))["display"]["frame_rate"])
    except (OSError, ValueError, TypeError, KeyError, ZeroDivisionError, RecursionError):
        return None  # a run says why a ground truth that exists cannot be used
    return rate if 0 < rate <= HIGHEST_RATE else None


def result_stem(name: str, folder: str = "") -> str:
    """Return the beginning of the names of an input's results.

    The stem depends only on the input's name and on `folder`, its folder below the folder or
    pattern that the user named. So it does not change if other inputs are added. Folders in it are
    separated by ``/``. A stem that is too long, or is not a valid file name on every system, gets a
    hash of the path.
    """
    stem = _stem(name)
    if len(os.fsencode(stem)) > _LONGEST_STEM or fault_of_stem(stem):
        stem = _with_hash(stem, name)
    inside = PurePath(folder, stem).as_posix()
    return _with_hash(stem, name) if fault_of_stem(inside) else inside


def each_once(stems: Mapping[str, str]) -> list[str]:
    """Return the names of single inputs, each input once; `stems` has their results' stems by name.

    Several spellings of a path are one input, and so are links to one file if their results have
    one stem. Otherwise links are inputs of their own, as their results are.
    """
    spelled = {_path_bytes(name): name for name in reversed(list(stems))}.values()
    once: dict[tuple[str, str], str] = {}
    for name in spelled:
        once[stems[name], os.path.realpath(name) if is_there(name) else name] = name
    return list(reversed(once.values()))


def _with_hash(stem: str, name: str) -> str:
    wrong = rf"[\x00-\x1f\x7f-\x9f/{re.escape(NOT_IN_NAMES)}]|(?<=^[A-Za-z]):"
    plain = re.sub(wrong, "-", stem)
    short = os.fsencode(plain)[:_LONGEST_STEM].decode("utf-8", "ignore")
    hashed = f"{short}-{hashlib.sha256(_path_bytes(name)).hexdigest()[:8]}"
    # On Windows even CON.1-12345678 is the name of a device.
    return f"input-{hashed}" if fault_of_stem(hashed) else hashed


def _path_bytes(name: str) -> bytes:
    path = name
    if is_folder(name):
        path = os.path.realpath(name)
    elif not is_camera_or_stream(name):
        folder, last = os.path.split(name)
        # `Path.resolve` would raise an error for a link to itself.
        path = os.path.join(os.path.realpath(folder), last)  # noqa: PTH118
    return path.encode("utf-8", "surrogateescape")


def _stem(name: str) -> str:
    if is_camera_or_stream(name):
        address = without_login(name).partition("?")[0]
        return re.sub(r"[^A-Za-z0-9.]+", "-", address).strip("-.")
    if is_folder(name):
        return Path(os.path.realpath(name)).name or "root"
    file, key = stack_and_key(name)
    if key:  # "flies.h5:/camera/left" gives "flies-camera-left"
        return "-".join((Path(file).stem, *key.split("/")))
    # "frames_%04d.png" gives "frames".
    without_number = re.sub(r"[_\-. ]*%0?\d*d", "", Path(name).stem)
    return without_number or Path(os.path.realpath(name)).parent.name or "input"
