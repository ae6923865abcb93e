"""The sidecar ``{stem}.oppload.json``: all that is needed to trust or repeat a result."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from oppload_cli.results.table import PartFile, cannot_write

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = "oppload.result/1"


def write_sidecar(path: Path, content: dict[str, Any]) -> None:
    """Write a sidecar; it appears whole or not at all.

    Parameters
    ----------
    path : Path
        Its final name.
    content : dict
        Ready for JSON.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    file = PartFile(path)
    try:
        json.dump({"schema": SCHEMA, **content}, file.stream, indent=2, allow_nan=False)
        file.stream.write("\n")
        file.commit()
    except BaseException as error:
        file.discard()
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise
