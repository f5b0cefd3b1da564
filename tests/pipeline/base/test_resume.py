"""Resume keys: whatever determines a result is in them, and nothing else. Whole runs: test_pool.py."""

import hashlib
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash, resume_key


def test_what_is_in_a_key(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("1")
    keys = [
        resume_key(module, settings, inputs)
        for module in ("stages.labels", "stages.ingest", ["stages.labels", "stages.ingest"])
        for settings in ({"k": 6}, {"k": 7})
        for inputs in ([file], ["a"], [file, "a"], ["a", file], [])
    ]
    file.write_text("2")
    keys.append(resume_key("stages.labels", {"k": 6}, [file]))
    assert len(set(keys)) == len(keys)


def test_what_is_not(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_text("1")
    first = resume_key("stages.labels", {"k": 6, "l": 7}, [tmp_path / "a"])
    assert resume_key(["stages.labels"], {"l": 7, "k": 6}, [tmp_path / "b"]) == first, "order, and names of files"


def test_file_hash(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert file_hash(tmp_path / "a") == hashlib.sha256(b"abc").hexdigest()
    with pytest.raises(InputError, match=r"nowhere is missing.*dvc pull"):
        file_hash(tmp_path / "nowhere")
