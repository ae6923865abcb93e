"""A signal is a flag until somebody asks; the second one acts as the system has it."""

from __future__ import annotations

import signal
import sys

import pytest

from tests.cli.process import python

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")

BEGIN = """
import os, signal, threading, time
from oppload_cli.processes import signals
from oppload_cli.processes.threads import Call, Prefetch
signal.signal(signal.SIGINT, signal.default_int_handler)
signals.handle()
def send(name="SIGINT"):
    os.kill(os.getpid(), getattr(signal, name))
"""
ASKED = """
send(); print("goes on", signals.received())
try: signals.stop_if_asked()
except KeyboardInterrupt: print("stops")
"""
NOT_ASKED = """
signals.stop_if_asked(); print(signals.received())
"""
IGNORED = """
signal.signal(signal.SIGHUP, signal.SIG_IGN)
signals.handle()
send("SIGHUP"); print(signals.received())
"""
TWICE = """
signals.time.sleep = lambda seconds: send()  # in the pause after the first signal
send(); print(signals.received())
"""
FRAMES = """
def frames():
    yield 1
    send()
    yield 2
    time.sleep(30)
items, seen = Prefetch(frames()), []
try: seen.extend(items)
except KeyboardInterrupt: print("stops")
"""
BLOCKED = """
threading.Timer(0.2, send).start()
try: Call(lambda: time.sleep(30)).result()
except KeyboardInterrupt: print("stops")
"""
WRITING = """
from pathlib import Path
from oppload_cli.files.atomic import PartFile
from oppload_cli.video.writers import _Sink
import tempfile
part = PartFile(Path(tempfile.mkdtemp()) / "a.mp4")
class File:
    name = "a"
    def write(self, data):
        send()
        return len(data)
print(_Sink(File()).write(b"some"), signals.received())
part.discard()
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (ASKED, ["goes on True", "stops"]),
        (NOT_ASKED, ["False"]),
        (IGNORED, ["False"]),
        (TWICE, ["True"]),
        (FRAMES, ["stops"]),
        (BLOCKED, ["stops"]),
        (WRITING, ["4 True"]),
    ],
    ids=["asked", "not-asked", "ignored", "twice", "frames", "blocked", "writing"],
)
def test_the_first_signal_stops_where_it_is_asked_for(words: str, said: list[str]) -> None:
    done = python(BEGIN + words)
    assert done.stderr == ""
    assert done.returncode == 0
    assert done.stdout.splitlines() == said


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_the_second_signal_ends_the_process(name: str) -> None:
    done = python(f"{BEGIN}send(); print('one', flush=True); send('{name}'); print('two')")
    assert done.returncode == -getattr(signal, name)
    assert done.stdout.splitlines() == ["one"]
    assert done.stderr == ""
