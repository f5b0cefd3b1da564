"""YAML that says one thing twice, or grows as it is read, is refused with its line."""

from pathlib import Path

import pytest

from pipeline.base import yaml_file
from pipeline.base.errors import InputError

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_anchors_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: &a {k: 6, share: 0.2}\nb: {<<: *a, k: 9}\nc: [1, 2011_09_26_drive_0001]\n")
    content = yaml_file.read(path)
    assert content == {"a": {"k": 6, "share": 0.2}, "b": {"k": 9, "share": 0.2}, "c": [1, "2011_09_26_drive_0001"]}
    assert yaml_file.parse(yaml_file.read_text(path), path) == content


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", r":3 is not valid YAML: duplicate key a"),
        ("a:\n  b: 1\n  b: 1\n", r":3 is not valid YAML: duplicate key b"),
        (BOMB, r"aliases are written out"),
        ("a: &a [*a]\n", r"aliases are written out"),
        ("a: " + "[" * 40 + "]" * 40, r"nested too deep"),
        ("a: " + "[" * 5000, r"nested too deep|not valid YAML"),
        ("\na: !!python/object/apply:os.system [ls]\n", r":2 is not valid YAML: could not determine a constructor"),
        ("a: " + "9" * 5000, r":1 is not valid YAML: a value of 5000 characters"),
        ("a: 2026-02-31\n", r"is not valid YAML: day is out of range"),
        ("a: [1\nb\n", r":3 is not valid YAML"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"^{path}.*{message}"):
        yaml_file.read(path)


def test_bytes_that_are_not_text(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes("a: ü\n".encode("latin-1"))
    with pytest.raises(InputError, match=rf"^{path} is not valid YAML: 'utf-8' codec"):
        yaml_file.read(path)
