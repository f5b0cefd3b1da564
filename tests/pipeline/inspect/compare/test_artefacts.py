"""JSON, CSV, checkpoints, other files, and folders of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint
from pipeline.inspect.compare import artefacts
from pipeline.inspect.compare.difference import Difference, Tally, apart


def differences(folder: Path, name: str, a: Any, b: Any, tolerance: float = 0.0) -> list[Difference]:
    for which, content in (("a", a), ("b", b)):
        (folder / which).mkdir(exist_ok=True)
        (folder / which / name).write_text(content)
    return list(artefacts.compare(name, folder / "a" / name, folder / "b" / name, tolerance))


def said(found: list[Difference]) -> dict[str, str]:
    return {each.where: each.how for each in found}


def test_json_differs_by_key(tmp_path: Path) -> None:
    a = '{"test": {"nmse": 0.25, "frames": 9, "x": null}, "seeds": [0, 1], "on": true, "old": 1}'
    b = '{"test": {"nmse": 0.5, "frames": 9.0, "x": 3}, "seeds": [0, 1, 2], "on": 1, "new": 1}'
    found = differences(tmp_path, "metrics.json", a, b)
    assert said(found) == {
        "test.nmse": "0.25 and 0.5", "test.x": "None and 3", "seeds[2]": "only in B", "on": "True and 1",
        "old": "only in A", "new": "only in B",
    }  # fmt: skip
    assert found[0].largest == 0.25
    assert "test.nmse" not in said(differences(tmp_path, "metrics.json", a, b, tolerance=0.3))
    assert differences(tmp_path, "metrics.json", '{"a": [1, 2]}', '{"a":[1.0,2]}') == []
    with pytest.raises(InputError, match=r"b/metrics\.json is not valid JSON"):
        differences(tmp_path, "metrics.json", a, "{")


def test_csv_differs_by_drive_frame_and_column(tmp_path: Path) -> None:
    a = "drive,frame,predicted_rad,valid\nx,1,,1\nx,2,0.5,1\ny,1,0.5,1\ny,2,0.5,yes\n"
    b = "drive,frame,predicted_rad,onset\ny,1,0.75,0\ny,2,0.5,0\nx,2,0.25,0\nx,1,0.5,0\nx,3,0.5,0\n"
    found = differences(tmp_path, "predictions.csv", a, b)
    assert said(found[:3]) == {"valid": "only in A", "onset": "only in B", "": "1 rows only in B, first x 3"}
    of_x, of_y = found[3:]
    assert (of_x.drive, of_x.frames, of_x.first_frame, of_x.largest_frame, of_x.largest) == ("x", 2, 1, 2, 0.25)
    assert (of_y.drive, of_y.count, of_y.total, of_y.first_frame) == ("y", 1, 2, 1)
    assert str(of_y) == "predictions.csv: y: predicted_rad: 1 of 2 values, in 1 frame, first 1, largest difference 0.25"
    by_row = differences(tmp_path, "curve.csv", "epoch,loss\n0,1.0\n1,0.5\n", "epoch,loss\n0,1.0\n1,0.25\n", 0.1)
    assert [(each.where, each.first_frame, each.largest) for each in by_row] == [("loss", 1, 0.25)]
    with pytest.raises(InputError, match=r"a/curve\.csv is not valid CSV"):
        differences(tmp_path, "curve.csv", 'a,b\n"x', "a,b\n1,2\n")


def test_checkpoints_differ_by_tensor(tmp_path: Path) -> None:
    net = {"w": torch.ones(2, 3), "half": torch.ones(2, dtype=torch.bfloat16), "gone": torch.ones(2)}
    other = {"w": torch.ones(2, 3), "half": torch.ones(2, dtype=torch.bfloat16), "gone": torch.ones(3)}
    other["w"][1, 2] = 1.5
    paths = [tmp_path / name / "best.pt" for name in "ab"]
    for path, state in zip(paths, (net, other), strict=True):
        checkpoint.write(path, {"kind": "net", "epoch": 3, "net": state})
    w, gone = artefacts.compare("best.pt", *paths, 0.0)
    assert (w.where, w.count, w.total, w.largest) == ("net.w", 1, 6, 0.5)
    assert (gone.where, gone.how) == ("net.gone", "shape (2,) and (3,)")
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    with pytest.raises(InputError, match=r"best\.pt"):
        list(artefacts.compare("best.pt", *paths, 0.0))


def test_other_files_differ_by_byte(tmp_path: Path) -> None:
    assert said(differences(tmp_path, "table.md", "one two", "one too")) == {"": "7 bytes, from byte 5 on"}
    assert said(differences(tmp_path, "table.md", "one", "one two")) == {"": "3 and 7 bytes, from byte 3 on"}


def test_folders_are_compared_file_by_file(tmp_path: Path) -> None:
    for name in ("a/x/one.json", "a/same.md", "b/same.md", "b/x/two.json", "a/.resume/block.h5"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
    pairs = artefacts.pairs(tmp_path / "a", tmp_path / "b")
    assert [name for name, *_ in pairs] == ["same.md", "x/one.json", "x/two.json"]
    found = [difference for pair in pairs for difference in artefacts.compare(*pair, 0.0)]
    assert [str(each) for each in found] == ["x/one.json: only in A", "x/two.json: only in B"]
    one = tmp_path / "a/x/one.json"
    assert artefacts.pairs(one, tmp_path / "b/x/two.json")[0][0] == "one.json"
    for a, b, why in (
        (tmp_path / "a", one, "is a folder, and"),
        (one, tmp_path / "b", "is a folder, and"),
        (one, tmp_path / "none.json", "none.json is missing"),
        (one, tmp_path / "a/same.md", "are files of two kinds"),
    ):
        with pytest.raises(InputError, match=why):
            artefacts.pairs(a, b)


def test_numbers_are_apart_beyond_the_tolerance() -> None:
    nan, inf = np.nan, np.inf
    a, b = np.array([1.0, nan, nan, inf, inf, 2.0]), np.array([1.5, nan, 1.0, inf, -inf, 2.0])
    assert apart(a, b, 0.0).tolist() == [True, False, True, False, True, False]
    assert apart(a, b, 0.5).tolist() == [False, False, True, False, True, False]
    assert apart(np.array([250], np.uint8), np.array([5], np.uint8), 200).tolist() == [True]
    big = np.array([2**60], np.int64)
    assert apart(big, big + 1, 0.5).tolist() == [True]  # which float64 cannot tell
    assert apart(np.array(["a"]), np.array(["b"]), 9.0).tolist() == [True]
    found = Tally(0.0)
    found.add_rows(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int))
    assert found.difference("file", "x") is None
