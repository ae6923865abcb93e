"""The families of the attack: each makes cases of one kind from random numbers."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from tests.robustness.inputs import Kind, make
from tools.attack import media
from tools.attack.judge import Case, execute, prepared
from tools.attack.server import CAMERA, LIES, Server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from random import Random

_QUICK = ("--height", "24", "--no-rmo")
_FIRST_USER = 61_000  # of 4000 users that have no other processes
_MANIFEST = "file,label,onset_frame,contact_frame"
# The weight of each family and the function that makes its cases. The share of the cases is the
# weight divided by the sum of all weights.
FAMILIES: dict[str, tuple[int, Callable[[Case, Random, Material], None]]] = {}
_NUMBERS = (
    *("0", "-1", "1", "0.5", "1e308", "-1e400", "1e-400", "nan", "inf", "²", "٣", "9" * 400),
    *("1e999999999", "0x10", "1_000", " 3 ", "", "+", "1/0", "3/7", "NaN", "1,5", "2147483648"),
)
_WORDS = (
    *("a", "..", ".", "../escaped", "/etc/passwd", "a/b", "a\\b", "C:x", "NUL", "con.txt", "-o"),
    *("--help", "-", "camera:0", "camera:²", "%d", "frames_%04d.png", "*", "[", "{", "$x$", "'"),
    *('"', "a\nb", "a\rb", "a\tb", "\x1b[31m", "é", "\u202e", "😀", "\ufeff", "a" * 300, " "),
    *("http://127.0.0.1:1/x", "rtsp:", "file:a", "concat:a|b", "pipe:0", "data:,", "~", "#", "."),
)


@dataclass(frozen=True)
class Material:
    """The files from which cases are made."""

    seeds: dict[str, Path]  # an intact video of each container and codec
    clip: Path
    film: Path  # a long video
    results: Path  # a folder with the results of two runs
    mounts: bool  # whether a disk can be mounted


def make_material(folder: Path) -> Material:
    """Make the files from which cases are made, or find them in the folder."""
    (folder / "cache").mkdir(parents=True, exist_ok=True)
    (folder / "cache").chmod(0o777)
    seeds = media.intact(folder / "seeds")
    clip, film, results = folder / "clip.avi", folder / "film.avi", folder / "results"
    if not results.exists():
        make(clip, Kind("avi", "ffv1", "gray", frames=12, full=True))
        make(film, Kind("avi", "mpeg4", frames=6000))
        case = prepared("results", 0, folder / "making")
        case.words = ["run", str(clip), str(seeds["mpeg4.avi"]), "-o", "../out", *_QUICK]
        ended = execute(case)
        if ended.code:
            raise RuntimeError(f"an intact file cannot be analysed: {ended.stderr}")
        case.out.rename(results)
        shutil.rmtree(case.folder)
    with suppress(OSError), _mounted(folder / "mount", "size=8k"):
        return Material(seeds, clip, film, results, mounts=True)
    return Material(seeds, clip, film, results, mounts=False)


def make_case(
    number: int, folder: Path, material: Material, random: Random, only: str = ""
) -> Case:
    """Return the case of this number; `only` names its family, or is empty."""
    family = only or family_of(number)
    case = prepared(family, number, folder)
    FAMILIES[family][1](case, random, material)
    return case


def family_of(number: int) -> str:
    """Return the family of a case, such that each family has its share of the cases."""
    turns = [name for name, (weight, _) in FAMILIES.items() for _ in range(weight)]
    return turns[number * 37 % len(turns)]  # 37: neighbours are of different families


def _family(weight: int) -> Callable[[Callable[[Case, Random, Material], None]], None]:
    """Decorate a function that makes the cases of a family."""

    def add(make: Callable[[Case, Random, Material], None]) -> None:
        FAMILIES[make.__name__] = weight, make

    return add


@contextmanager
def _mounted(folder: Path, options: str) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if subprocess.run(words, capture_output=True, check=False).returncode:
        raise OSError
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)  # noqa: S607


def _damaged(data: bytes, random: Random) -> bytes:
    return media.damaged(data, random.choice(media.WAYS), random)


def _damaged_file(case: Case, random: Random, material: Material) -> str:
    """Put one damaged file into the case; return its name."""
    name, path = random.choice(list(material.seeds.items()))
    if random.random() >= 0.9:  # the suffix of another container
        name = f"x{Path(random.choice(list(material.seeds))).suffix}"
    data = path.read_bytes()
    for _ in range(random.choice((1, 1, 1, 2))):
        data = _damaged(data or b"\0", random)
    name = f"{random.randrange(10**6)}-{name}"
    (case.folder / "in" / name).write_bytes(data)
    return name


def _hostile_name(random: Random) -> bytes:
    """Return a file name of any bytes except NUL and the slash."""
    choice = random.randrange(4)
    if choice == 0:
        name = random.choice(_WORDS).encode()
    elif choice == 1:
        name = random.randbytes(random.choice((1, 3, 20, 200)))
    elif choice == 2:
        name = "".join(chr(random.randrange(1, 0xD800)) for _ in range(12)).encode()
    else:
        name = b"n" * random.choice((240, 250, 255))
    name = name.replace(b"/", b"_").replace(b"\0", b"_")[:248] or b"x"
    return name + random.choice((b"", b".avi", b".mp4", b".png", b".AVI", b"."))


@_family(40)
def media_files(case: Case, random: Random, material: Material) -> None:
    """Damaged files, one or several at a time."""
    case.files = random.choice((1, 1, 1, 4))
    names = [_damaged_file(case, random, material) for _ in range(case.files)]
    more: list[str] = random.choice(
        ([], [], [], ["--annotate"], ["--jobs", "2"], ["--start", "f2"], ["--end", "0.2"])
    )
    case.words = ["run", *names, "-o", "../out", *_QUICK, *more]
    case.codes = frozenset({0, 2, 3, 4})


@_family(8)
def images(case: Case, random: Random, material: Material) -> None:
    """Folders of images; some of them are damaged, or are other files with the suffix of images."""
    del material
    folder = case.folder / "in" / "images"
    folder.mkdir()
    suffix = random.choice(("png", "jpg", "bmp", "ppm", "tiff", "webp"))
    pattern = random.choice(("{}", "f{:03}", "1{}²", "x{}٣", "{} a", "a.{}"))
    for index in range(random.choice((2, 5))):
        pixels = np.full((16 + 8 * (random.random() < 0.1), 24), 20 * index, np.uint8)
        mode = random.choice(("L", "L", "RGB", "P", "1", "I", "F", "CMYK", "RGBA", "LA"))
        path = folder / f"{pattern.format(index)}.{suffix}"
        try:
            Image.fromarray(pixels).convert(mode).save(path)
        except OSError:  # the format cannot hold pictures of this mode
            Image.fromarray(pixels).save(path)
        if random.random() < 0.3:
            path.write_bytes(_damaged(path.read_bytes(), random))
    for _ in range(random.choice((0, 1, 2))):
        _make_strange(folder / f"{random.randrange(10**6)}s.{suffix}", random)
    place = random.choice(("images", f"images/%d.{suffix}", f"images/*.{suffix}", "."))
    case.files = 8
    case.words = ["run", place, "-o", "../out", *_QUICK]
    case.words += random.choice(([], ["-r"], ["--image-rate", random.choice(_NUMBERS)]))


def _make_strange(path: Path, random: Random) -> None:
    """Make a link, a pipe, a folder or a file that is not an image."""
    kind = random.choice(("loop", "gone", "pipe", "folder", "empty", "text", "sparse"))
    if kind == "sparse":
        with path.open("wb") as file:
            file.write(b"\x89PNG\r\n\x1a\n")
            file.truncate(1 << 32)
    elif kind in {"empty", "text"}:
        path.write_bytes(b"" if kind == "empty" else b"text" * 99)
    else:
        _make_special(path, kind, "nowhere")


def _make_special(path: Path, kind: str, target: str | Path) -> None:
    """Make a pipe, a folder, or a link to itself (loop) or to a target (link, gone)."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(path.name if kind == "loop" else target)


@_family(8)
def names(case: Case, random: Random, material: Material) -> None:
    """Files with hostile names, and commands on their results."""
    # As in most languages; in the language C, Python itself prints any bytes.
    case.environment = {"PYTHONIOENCODING": "utf-8:strict"}
    name = _hostile_name(random)
    word = os.fsdecode(name)
    with suppress(OSError):
        shutil.copy(material.clip, case.folder / "in" / word)
    if random.random() < 0.6:
        case.words = ["run", "-o", "../out", *_QUICK, "--", word]
        return
    stem = os.fsdecode(name[:200])
    table, inside = f"{stem}.frames.csv", case.folder / "in" / "r"
    inside.mkdir()
    shutil.copy(material.results / "clip.frames.csv", inside / table)
    text = (material.results / "clip.oppload.json").read_text()
    (inside / f"{stem}.oppload.json").write_text(text.replace('"clip.avi"', json.dumps(word)))
    case.words = random.choice(
        (
            ["plot", f"./r/{table}", "-o", "../out/a.png"],
            ["plot", "-o", "../out/a.svg", "--", f"r/{table}"],
            ["collect", "r", "-o", "../out/all.csv"],
            ["collect", "--frames", "r", "-o", "../out/all.csv"],
            ["report", f"r/{table}", "-o", "../out"],
        )
    )


@_family(8)
def limits(case: Case, random: Random, material: Material) -> None:
    """Limits of processes, size of files and number of open files."""
    kind = random.choice(("nproc", "fsize", "nofile"))
    if kind == "nproc":
        amount = random.randrange(1, 13)
        if os.geteuid() == 0:  # the limit does not hold for root
            case.user = _FIRST_USER + os.getpid() % 4000  # only this case counts for the user
    elif kind == "fsize":
        amount = random.choice((0, 1, 100, 1000, 10_000, 100_000, 1_000_000))
    else:
        amount = random.randrange(8, 40)
    case.limits = {kind: amount}
    clip = str(material.clip)
    case.words = random.choice(
        (
            ["run", clip, "-o", "../out", *_QUICK],
            ["run", clip, "-o", "../out", *_QUICK, "--annotate"],
            ["run", clip, "-o", "../out", "--height", "24"],
            ["run", clip, "nothing.avi", "-o", "../out", *_QUICK, "--jobs", "2"],
            ["plot", str(material.results / "clip.frames.csv"), "-o", "../out/a.png"],
            ["collect", str(material.results), "-o", "../out/all.csv"],
            ["stimuli", "generate", "controls/appearing-disk", "-o", "../out", "-q"],
            ["tune", "klapoetke2017/bar-expand-10", "--over", "speed=40", "-o", "../out", "-q"],
        )
    )


@_family(9)
def signals(case: Case, random: Random, material: Material) -> None:
    """Signals at random moments, also during the start; some signals are sent twice."""
    case.words = random.choice(
        (
            ["run", str(material.film), "-o", "../out", *_QUICK],
            ["run", str(material.film), "-o", "../out", *_QUICK, "--annotate"],
            ["run", str(material.film), str(material.clip), "-o", "../out", *_QUICK, "-j", "2"],
            ["run", str(material.film), "-o", "../out", *_QUICK, "--if-exists", "overwrite"],
            ["stimuli", "generate", "controls/*", "-o", "../out", "--jobs", "2"],
            ["tune", "klapoetke2017/bar-expand-10", "-o", "../out", "--jobs", "2"],
            ["collect", str(material.results), "-o", "../out/all.csv"],
        )
    )
    moment = random.choice((random.uniform(0, 0.4), random.uniform(0, 3)))
    name = random.choice(("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"))
    group = random.random() < 0.5
    case.signals = [(moment, name, group)]
    if random.random() < 0.2:
        case.signals.append((moment + random.uniform(0, 0.2), name, group))


@_family(6)
def disks(case: Case, random: Random, material: Material) -> None:
    """Disks that are full or read-only, bad output folders, and special files at result names."""
    clip, table = str(material.clip), str(material.results / "clip.frames.csv")
    kinds = ["file", "long", "links", "device", "gone"]
    kind = random.choice([*kinds, "small", "small", "fixed"] if material.mounts else kinds)
    out = {"file": "../in/file", "long": "../out/" + "n" * 300, "device": "/dev/full"}.get(
        kind, "../out"
    )
    (case.folder / "in" / "file").write_text("in the way")
    if kind in {"small", "fixed"}:
        room = f"size={random.choice((4, 8, 12, 16, 24, 40, 100, 400))}k"
        case.around.append(_mounted(case.out, "ro" if kind == "fixed" else room))
    elif kind == "gone":
        case.out.rmdir()
    elif kind == "links":
        for name in ("clip.frames.csv", "clip.oppload.json", "failures.csv", "a.png", "all.csv"):
            path = case.out / f"{name}{random.choice(('', '.part'))}"
            special = random.choice(("link", "gone", "loop", "pipe", "folder", "none", "none"))
            target = "in/file" if special == "link" else "home/escaped"
            if special != "none":
                _make_special(path, special, case.folder / target)
    case.files = 3
    case.words = random.choice(
        (
            ["run", clip, "-o", out, *_QUICK],
            ["run", clip, "-o", out, *_QUICK, "--annotate"],
            ["run", clip, "-o", out, *_QUICK, "--report"],
            ["run", clip, str(material.seeds["mpeg4.avi"]), "nothing", "-o", out, *_QUICK],
            ["collect", str(material.results), "-o", f"{out}/all.csv"],
            ["plot", table, "-o", f"{out}/a.{random.choice(('png', 'svg', 'pdf'))}"],
            ["report", table, "-o", out],
            ["stimuli", "generate", "controls/appearing-disk", "-o", out, "--preview", "-q"],
            ["tune", "klapoetke2017/bar-expand-10", "--over", "speed=40", "-o", out, "-q"],
        )
    )
    if random.random() < 0.5 and "--if-exists" not in case.words and kind == "links":
        case.words += ["--if-exists", "overwrite"]


@_family(5)
def lists(case: Case, random: Random, material: Material) -> None:
    """Give inputs in lists."""
    known = (str(material.clip), "nothing.avi", *_WORDS[:14], *_WORDS)
    names = [random.choice(known) for _ in range(random.choice((1, 3, 6)))]
    data = random.choice("\n\0").join(names).encode("utf-8", "surrogateescape")
    if random.random() < 0.3:
        data = _damaged(data, random)
    case.files = data.count(b"\n") + data.count(b"\0") + data.count(b"\r") + len(names)
    more: list[str] = random.choice(([], [], ["-0"], ["--jobs", "2"], ["--shard", "1/2"]))
    case.words = ["run", "-o", "../out", *_QUICK, "-q", *more, "--files-from"]
    if random.random() < 0.3:
        case.stdin = data
        case.words.append("-")
    else:
        (case.folder / "in" / "list.csv").write_bytes(data)
        case.words.append("list.csv")


@_family(2)
def manifests(case: Case, random: Random, material: Material) -> None:
    """Manifests of labelled clips."""
    rows = [_MANIFEST]
    for _ in range(random.choice((1, 2))):
        cells = [str(material.clip), random.choice(("looming", "none")), "2", "9"]
        if random.random() < 0.7:
            cells[random.randrange(4)] = random.choice((*_NUMBERS, *_WORDS))
        rows.append(",".join(cells))
    data = "\n".join(rows).encode("utf-8", "surrogateescape")
    if random.random() < 0.4:
        data = _damaged(data, random)
    (case.folder / "in" / "m.csv").write_bytes(data)
    case.files = 4
    case.words = ["evaluate", "m.csv", "-o", "../out", "-q", "--draws", "100", "--jobs", "1"]


@_family(7)
def sidecars(case: Case, random: Random, material: Material) -> None:
    """Results in which a sidecar or a table was changed."""
    inside = case.folder / "in" / "r"
    shutil.copytree(material.results, inside)
    victims = [path for path in sorted(inside.iterdir()) if path.suffix in {".json", ".csv"}]
    for _ in range(random.choice((1, 2))):
        path = random.choice(victims)
        data = path.read_bytes()
        if path.suffix == ".json" and random.random() < 0.7:
            with suppress(ValueError):
                data = _with_another_value(json.loads(data), random)
        elif path.suffix == ".csv" and random.random() < 0.5:
            cells = data.replace(b"\n", b"\n,").split(b",")
            cells[random.randrange(len(cells))] = random.choice((*_NUMBERS, *_WORDS)).encode()
            data = b",".join(cells).replace(b"\n,", b"\n")
        else:
            data = _damaged(data or b"{", random)
        path.write_bytes(data)
    case.files = 2
    case.words = random.choice(
        (
            ["collect", "r", "-o", "../out/all.csv"],
            ["collect", "--frames", "r", "-o", "../out/all.csv"],
            ["plot", "r/clip.frames.csv", "-o", "../out/a.png"],
            ["plot", "r/clip.frames.csv", "r/mpeg4.frames.csv", "-o", "../out/a.svg"],
            ["report", "r/clip.frames.csv", "-o", "../out"],
            ["run", str(material.clip), "-o", "r", *_QUICK, "--if-exists", "skip", "--dry-run"],
        )
    )


def _with_another_value(value: Any, random: Random) -> bytes:
    """Return JSON in which one value, at any depth, is replaced."""
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        keys = node.keys() if isinstance(node, dict) else range(len(node))
        for key in keys:
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(value)
    container, key = random.choice(places)
    mark = "the other value"
    container[key] = mark
    deep = "[" * 5000 + "]" * 5000
    others = [*map(json.dumps, (*_NUMBERS, *_WORDS)), "NaN", "Infinity", "1e999", "9" * 5000, deep]
    others += ["null", "true", "[]", "{}", '"\\ud800"', '"\\u0000"', '{"a": 1, "a": 2}', "-1", "0"]
    return json.dumps(value).replace(json.dumps(mark), random.choice(others)).encode()


@_family(4)
def servers(case: Case, random: Random, material: Material) -> None:
    """HTTP servers that cut, stall and lie."""
    name = random.choice([each for each in material.seeds if not each.endswith((".obu", ".jp2"))])
    stalls = random.random() < 0.1
    share = random.choice((0, 0.01, 0.3, 0.6, 0.95, 1))
    lie = random.choice((*LIES, "", "", "", ""))
    path = case.folder / "in" / name
    shutil.copy(material.seeds[name], path)
    if random.random() < 0.3:
        path.write_bytes(_damaged(path.read_bytes(), random))
    server = Server(path, share, stalls=stalls, lie=lie)
    case.around.append(server)
    case.words = ["run", server.url, "-o", "../out", *_QUICK]
    case.codes = frozenset({0, 3, 4})


@_family(2)
def cameras(case: Case, random: Random, material: Material) -> None:
    """Network cameras that send images with and without faults, one by one."""
    del material
    content, faulty = b"", random.choice((0, 0.1, 0.5))
    for index in range(random.choice((5, 30))):
        image, kind = media.jpeg(index, mode=random.choice(("L", "RGB", "CMYK"))), b"jpeg"
        size: int | None = len(image)
        if random.random() < faulty:
            image = random.choice((_damaged(image, random), b"", media.jpeg(index, 200)))
            size = random.choice((len(image), None, 0, 9 * len(image), -1))
            kind = random.choice((b"jpeg", b"jpeg", b"png", b"x"))
        length = b"" if size is None else b"Content-Length: %d\r\n" % size
        content += b"--frame\r\nContent-Type: image/" + kind + b"\r\n" + length
        content += b"\r\n" + image + b"\r\n"
    path = case.folder / "in" / "video.mjpg"
    path.write_bytes(content + random.choice((b"", b"--frame--\r\n")))
    stated = random.choice((CAMERA, CAMERA, CAMERA.replace("frame", '"frame"'), CAMERA[:25], ""))
    lie = random.choice(("no length", "no length", "drips", ""))
    server = Server(path, random.choice((1, 1, 0.6)), lie=lie, kind=stated)
    case.around.append(server)
    case.files = 2  # a short stream of images has several remarks
    case.words = ["run", server.url, "-o", "../out", *_QUICK]
    case.codes = frozenset({0, 3, 4})


@_family(3)
def surroundings(case: Case, random: Random, material: Material) -> None:
    """Environments of services and containers: no home, a single core."""
    names = ("HOME", "TMPDIR", "LANG", "LC_ALL", "TERM", "COLUMNS", "NO_COLOR", "PATH")
    values = (None, None, "", "/nowhere", "C", "0", "dumb", "\udcff")
    case.environment = {name: random.choice(values) for name in names if random.random() < 0.4}
    case.umask = random.choice((0o22, 0o77, 0o27))
    case.one_core = random.random() < 0.5
    clip, seed = str(material.clip), random.choice(list(material.seeds.values()))
    case.words = random.choice(
        (
            ["run", clip, "-o", "../out", *_QUICK],
            ["run", clip, "-o", "../out", *_QUICK, "--annotate"],
            ["run", clip, "-o", "../out", *_QUICK, "--report"],
            ["run", clip, str(seed), "-o", "../out", *_QUICK, "--jobs", "2"],
            ["collect", str(material.results), "-o", "../out/all.csv"],
            ["stimuli", "generate", "controls/appearing-disk", "-o", "../out", "-q"],
            ["info"],
        )
    )
    case.files = 2


@_family(2)
def pipes(case: Case, random: Random, material: Material) -> None:
    """Tables that are streamed to a program that stops reading."""
    case.words = ["run", str(material.film), "-o", "-", *_QUICK, "-q"]
    case.reads = random.choice((0, 1, 100, 5000, 20_000))
    if random.random() < 0.2:
        case.words[1] = str(material.seeds[random.choice(list(material.seeds))])


@_family(5)
def settings(case: Case, random: Random, material: Material) -> None:
    """Options, settings and protocols with any values."""
    value = random.choice((*_NUMBERS, *_WORDS)).replace("\0", "")
    clip, table = str(material.clip), str(material.results / "clip.frames.csv")
    run = ["run", clip, "-o", "../out", "--no-rmo"]
    option = random.choice(
        ("--height", "--start", "--end", "--duration", "--fov", "--image-rate", "--model", "--jobs")
    )
    name = random.choice(("reference_rate", "pool_sigma", "gain", "receptive_field", "axes", "x"))
    text = f"height = 24\n[opplod]\n{name} = {value}\n".encode("utf-8", "surrogateescape")
    if random.random() < 0.3:
        text = media.damaged(text, random.choice(media.WAYS), random)
    (case.folder / "in" / "s.toml").write_bytes(text)
    (case.folder / "in" / "p.toml").write_bytes(_protocol(random))
    case.words = random.choice(
        (
            [*run, "--height", "24", f"{option}={value}"],
            [*run, "--height", "24", "--set", f"opplod.{name}={value}"],
            [*run, "--config", "s.toml"],
            ["config", "--config", "s.toml"],
            ["stimuli", "show", "p.toml"],
            ["stimuli", "show", "p.toml"],
            ["stimuli", "show", value],
            ["plot", table, "-o", "../out/a.png", "--kind", value],
            [value, value],
        )
    )
    case.files = 5


def _protocol(random: Random) -> bytes:
    """Return a protocol of the catalogue in which some values are replaced."""
    root = Path(__file__).resolve().parents[2] / "stimuli"
    path = random.choice(sorted(root.rglob("*.toml")))
    data = path.read_bytes()
    if random.random() < 0.5:
        return _damaged(data, random)
    lines = data.split(b"\n")
    places = [number for number, line in enumerate(lines) if b"=" in line]
    for _ in range(random.choice((1, 2))):
        place = random.choice(places)
        name = lines[place].partition(b"=")[0]
        lines[place] = name + b"= " + random.choice((*_NUMBERS, '"a"', "[1]", "true")).encode()
    return b"\n".join(lines)
