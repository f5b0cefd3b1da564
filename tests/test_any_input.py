"""Any text and any bytes: readers return what is sound or raise the one line that users read, and nothing else."""

import json
import string
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.base import store, yaml_file
from pipeline.base.errors import InputError
from pipeline.base.params import parse
from pipeline.camera.calib_file import projection, read_entries
from pipeline.camera.pixels import read_pixels
from pipeline.fitting import checkpoint
from pipeline.kitti import oxts
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.sections.ingest import Drives

# Seeds are fixed, so that a run tells of the code and not of luck; files in tmp_path are written anew each time.
anything = settings(
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NUMBERS = st.floats(allow_nan=True).map(repr) | st.integers().map(str) | st.text(max_size=6)
WORDS = st.lists(NUMBERS, max_size=40).map(" ".join)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
)
READERS: dict[str, tuple[st.SearchStrategy[bytes], Callable[[Path], Any]]] = {
    "oxts": (WORDS.map(str.encode), oxts.read_row),
    "timestamps": (st.lists(WORDS | st.just("2011-09-26 13:02:25.5")).map("\n".join).map(str.encode),
                   lambda path: oxts.read_times(path, [0, 1, 2])),
    "calibration": (st.lists(st.tuples(st.sampled_from(["P_rect_02", "S_rect_02", "R"]), WORDS)).map(
                        lambda lines: "\n".join(": ".join(line) for line in lines).encode()),
                    lambda path: projection(read_entries(path), 2, path)),
    "scan": (st.binary(max_size=4000), read_scan),
    "png": (st.binary(max_size=400).map(lambda tail: b"\x89PNG\r\n\x1a\n" + tail), read_pixels),
    "jpeg": (st.binary(max_size=400).map(lambda tail: b"\xff\xd8" + tail + b"\xff\xd9"), read_pixels),
    "checkpoint": (st.binary(max_size=400).map(lambda tail: b"PK\x03\x04" + tail), checkpoint.load),
    "yaml": (st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")), yaml_file.read),
    "yaml of signs": (st.text("&*!<>[]{}:,|-? a1\n\"'", max_size=60).map(str.encode), yaml_file.read),
    "json": (JSON.map(lambda value: json.dumps(value).encode()), lambda path: store.read_json(path, stage="x")),
    "bytes as json": (st.binary(max_size=99), lambda path: store.read_json(path, stage="x")),
    "hdf5": (st.binary(max_size=400).map(lambda tail: b"\x89HDF\r\n\x1a\n" + tail),
             lambda path: store.DriveReader(path, stage="x")),
}  # fmt: skip


def check_names(path: Path, error: InputError) -> None:
    assert path.name in str(error)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_any_content_is_read_or_refused_in_a_line(tmp_path: Path, name: str) -> None:
    contents, read = READERS[name]
    path = tmp_path / "file"

    @anything
    @given(contents)
    def tried(content: bytes) -> None:
        path.write_bytes(content)
        try:
            read(path)
        except InputError as error:
            check_names(path, error)

    tried()


@anything
@given(st.lists(st.floats(-1e4, 1e4), min_size=30, max_size=30))
def test_a_packet_that_is_read_is_one_of_a_car(tmp_path: Path, values: list[float]) -> None:
    path = tmp_path / "0.txt"
    path.write_text(" ".join(map(repr, values)))
    try:
        row = oxts.read_row(path)
    except InputError:
        assert any(abs(values[oxts.COLUMNS.index(name)]) > limit for name, limit in oxts.LIMITS.items())
    else:
        assert row.tolist() == values


@anything
@given(JSON)
def test_any_index_is_read_or_refused(tmp_path: Path, drives: Any) -> None:
    store.write_json(tmp_path / "index.json", {"schema": store.SCHEMA, "drives": json.loads(json.dumps(drives).replace(
        "NaN", "0").replace("-Infinity", "0").replace("Infinity", "0"))})  # fmt: skip
    try:
        assert set(store.read_index(tmp_path, stage="labels").values()) <= {"train", "val", "test"}
    except InputError as error:
        check_names(tmp_path, error)


@anything
@given(st.from_regex(r"\A\d{4}_\d{2}_\d{2}_drive_\d{4}\Z") | st.text(string.digits + "_./driveＡ１", max_size=24))
def test_a_drive_is_named_after_a_day(name: str) -> None:
    try:
        drives = parse(Drives, {"train": [name], "test": ["2011_09_26_drive_0001"]}, "drives")
    except InputError:
        return
    np.datetime64(drives.train[0][:10].replace("_", "-"))  # raises for a day that there is not
    assert name.isascii()


@anything
@given(
    st.sets(
        st.integers(0, 10**12).map(str) | st.text(max_size=4).filter(lambda text: "/" not in text and "\0" not in text),
        max_size=5,
    )
)
def test_frames_are_numbered_once(tmp_path: Path, names: set[str]) -> None:
    folder = tmp_path / str(abs(hash(frozenset(names)))) / "oxts/data"
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / f"{name.encode('utf-8', 'replace').decode()}.txt").touch()
    try:
        frames = RawDrive(folder.parents[1]).oxts
    except InputError as error:
        check_names(folder, error)
    else:
        assert len({*frames.values()}) == len(frames)
        assert all(0 <= number < 2**31 for number in frames)
