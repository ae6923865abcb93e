"""Folders made for results, if no result comes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import OutputError
from oppload_cli.files.atomic import claimed, folder_of_outputs

if TYPE_CHECKING:
    from pathlib import Path


def test_new_folders_without_a_file_are_removed_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    with folder_of_outputs(tmp_path / "old"):
        pass
    with pytest.raises(ZeroDivisionError), folder_of_outputs(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    with folder_of_outputs(tmp_path / "c" / "d"):
        (tmp_path / "c" / "result").touch()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["c", "old", "result"]


@pytest.mark.parametrize("committed", [False, True])
def test_a_claimed_file_exists_only_after_its_commit(tmp_path: Path, *, committed: bool) -> None:
    path = tmp_path / "new" / "a.csv"
    with claimed(path, "error") as file:
        assert file.part.exists()
        assert not path.exists()
        file.stream.write("a\n")
        if committed:
            file.commit()
    assert [path.name for path in tmp_path.rglob("*")] == ["new", "a.csv"] * committed
    if committed:
        assert path.read_bytes() == b"a\n"
        with pytest.raises(OutputError, match="exists already"), claimed(path, "error"):
            pass
        with claimed(path, "overwrite"):  # without a commit the old file stays
            pass
        assert path.read_bytes() == b"a\n"
