"""Names of files that come from data: a list, a sidecar or a manifest must not lead elsewhere."""

from __future__ import annotations

import re
import sys
import unicodedata
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_SEPARATORS = "/\\" + ('<>:"|?*' if sys.platform == "win32" else "")
_DRIVE = re.compile(r"[A-Za-z]:")
# Windows opens a device under these names, whatever the folder and the suffix.
_DEVICES = re.compile(r"(CON|PRN|AUX|NUL|CONIN\$|CONOUT\$|(COM|LPT)[0-9¹²³])\s*(\..*)?", re.I)


def fault_of_name(name: str) -> str:
    """Return why a text is no plain file name, on any system; empty for a plain one.

    Parameters
    ----------
    name : str
        Such as the stem of a result; undecodable bytes are allowed in it.

    Returns
    -------
    str
        The end of a sentence, such as ``holds '/'``.
    """
    if not name.strip(". "):
        return "names no file"
    separator = next((each for each in name if each in _SEPARATORS), "")
    if separator:
        return f"holds '{separator}'"
    if _DRIVE.match(name):
        return "begins with a drive"
    if any(unicodedata.category(each) == "Cc" for each in name):
        return "holds a control character"
    return "is a device on Windows" if _DEVICES.fullmatch(name) else ""


def fault_of_stem(stem: str) -> str:
    """Return why a stem with folders in it, such as ``cam1/clip``, leads out of its folder.

    Parameters
    ----------
    stem : str
        File names, separated by ``/``.

    Returns
    -------
    str
        As from :func:`fault_of_name`, of the first name that is no plain one.
    """
    return next(filter(None, map(fault_of_name, stem.split("/"))), "")


def is_file(path: Path) -> bool:
    """Tell whether a file of any name is there; unlike `Path.is_file`, raise no error."""
    with suppress(OSError, ValueError):  # too long, not to be looked up, or with a NUL in it
        return path.is_file()
    return False


def is_folder(path: Path) -> bool:
    """Tell whether a folder of any name is there; unlike `Path.is_dir`, raise no error."""
    with suppress(OSError, ValueError):
        return path.is_dir()
    return False


def is_there(path: Path) -> bool:
    """Tell whether anything of a name is there; unlike `Path.exists`, raise no error."""
    with suppress(OSError, ValueError):
        return path.exists()
    return False
