"""Files are read if they are files, and of a size that they can have."""

import os
from pathlib import Path

import pytest

from pipeline.base.errors import DamagedFile
from pipeline.base.files import check_file, read_bytes


def test_a_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"123")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert read_bytes(tmp_path / "link", 3) == b"123"
    assert check_file(tmp_path / "a", 3) == 3
    with pytest.raises(FileNotFoundError):
        read_bytes(tmp_path / "b", 3)


def test_what_would_never_end_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(6 << 30)
    for path, what in (("pipe", "a pipe"), ("zero", "a device"), (".", "a folder"), ("large", "6442450944 bytes")):
        with pytest.raises(DamagedFile, match=what):
            read_bytes(tmp_path / path, 1 << 20)
