"""Where a signal becomes an exception at once, and where a moment later."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")

BEGIN = """
import os, signal, sys, time
from oppload_cli import interruption
signal.signal(signal.SIGINT, signal.default_int_handler)
interruption.answer("SIGINT")
"""
AT_ONCE = """
def step():
    os.kill(os.getpid(), signal.SIGINT)
    print("whole")
"""
UNDISTURBED = f"""
@interruption.undisturbed
{AT_ONCE.strip()}
"""
STEP = """
try:
    step()
    time.sleep(30)
except interruption.Signalled:
    print("interrupted")
"""
# What the loader of extensions calls for the extension's own code.
LOADING = f"""
{AT_ONCE.strip()}
import _imp
from importlib.machinery import ExtensionFileLoader
own = step
_imp.exec_dynamic = lambda module: own()
step = lambda: ExtensionFileLoader("name", "path").exec_module(None)
"""
# What Python calls when the lock of an import is gone.
UNLOCKING = f"""
{AT_ONCE.strip()}
import _frozen_importlib
class Locks(dict):
    def get(self, *words):
        own()
        return super().get(*words)
def unlock():
    lock = _frozen_importlib._get_module_lock("nothing")
    _frozen_importlib._module_locks = Locks(_frozen_importlib._module_locks)
own, step = step, unlock
"""
# What the encoder's library calls from C.
WRITING = f"""
{AT_ONCE.strip()}
from oppload_cli.video.sink import Sink
class File:
    def write(self, data):
        own()
        return len(data)
own, sink = step, Sink(os.devnull)
sink._file = File()
step = lambda: sink.write(b"some")
"""
# Asked again while it cleans up, and once more when that has taken too long.
AGAIN = """
try:
    step()
    time.sleep(30)
except interruption.Signalled:
    step()
    interruption.PATIENCE_S = 0
    try:
        step()
    except interruption.Signalled:
        print("interrupted")
"""
IGNORED = """
signal.signal(signal.SIGINT, signal.SIG_IGN)
interruption.answer("SIGINT")
os.kill(os.getpid(), signal.SIGINT)
print("ignored", interruption.received())
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (AT_ONCE + STEP, ["interrupted"]),
        (AT_ONCE + AGAIN, ["whole", "interrupted"]),
        (UNDISTURBED + STEP, ["whole", "interrupted"]),
        (LOADING + STEP, ["whole", "interrupted"]),
        (UNLOCKING + STEP, ["whole", "interrupted"]),
        (WRITING + STEP, ["whole", "interrupted"]),
        (IGNORED, ["ignored False"]),
    ],
)
def test_when_a_signal_interrupts(words: str, said: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stderr == ""
    assert done.returncode == 0
    assert done.stdout.split("\n")[:-1] == said
