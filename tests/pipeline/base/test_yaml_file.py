"""YAML files are read as YAML 1.2; faults have a line."""

from pathlib import Path

import pytest

from pipeline.base import yaml_file
from pipeline.base.errors import InputError


def test_anchors_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: &a {k: 6, share: 0.2}\nb: {<<: *a, k: 9}\nc: [1, 2011_09_26_drive_0001]\n")
    content = {"a": {"k": 6, "share": 0.2}, "b": {"k": 9, "share": 0.2}, "c": [1, "2011_09_26_drive_0001"]}
    assert yaml_file.read(path) == content


@pytest.mark.parametrize(
    ("content", "where", "problem"),
    [
        (b"a: 1\nb: 2\na: 3\n", ":3", "duplicate key"),
        (b"\na: !!python/object/apply:os.system [ls]\n", ":2", "could not determine a constructor"),
        (b"a: [1\nb\n", ":3", "invalid YAML"),
        (b"a: " + b"[" * 5000, "", "invalid YAML"),
        ("a: ü\n".encode("latin-1"), "", "invalid UTF-8"),
    ],
)
def test_faults(tmp_path: Path, content: bytes, where: str, problem: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as raised:
        yaml_file.read(path)
    assert raised.value.where == f"{path}{where}"
