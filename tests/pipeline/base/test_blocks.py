"""A drive's file of blocks: what goes in comes out, and neither blocks nor parts show in its bytes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.blocks import BlockWriter, encode, join, read_block
from pipeline.base.store import DriveReader, DriveWriter

DRIVE = "2011_09_26_drive_0001"
COUNTS = [5000, 0, 9000, 3000, 8192, 1, 20000]  # rows of the frames; chunks have 8192
FILLED = [1, 2, 5]


def write(file: DriveWriter, frames: range) -> None:
    """Write some frames of a drive, with every kind of dataset."""
    file.attrs["camera"] = 2
    file.put("frame", np.array(frames, np.int32))
    file.put("T", np.array([np.full((4, 4), frame, np.float32) for frame in frames]).reshape(-1, 4, 4), "m")
    file.put_once("K", np.eye(3), "pixels")
    file.append("xyz", np.empty((0, 3), np.float32), "m")
    file.append("image", np.empty((0, 8, 9), np.uint8))
    file.blank("cls", (len(frames), 8, 9), np.uint8, "trainId", value=255)
    for index, frame in enumerate(frames):
        rng = np.random.default_rng(frame)
        file.append("xyz", rng.normal(size=(COUNTS[frame], 3)).astype(np.float32))
        file.append("image", rng.integers(0, 9, (1, 8, 9), np.uint8))
        if frame in FILLED:
            file.fill("cls", index, np.full((8, 9), frame, np.uint8))
    file.put_pointers("ptr", (COUNTS[frame] for frame in frames), "row")


def assembled(folder: Path, spans: Sequence[range], parts: int) -> Path:
    blocks, encoded = [], []
    for span in spans:
        path = folder / f"{span.start}-{span.stop}.npz"
        with BlockWriter(path, stage="clouds", drive=DRIVE, params={"k": 6}) as file:
            write(file, span)
        blocks.append(read_block(path))
    for part in reversed(range(parts)):  # in any order
        encode(blocks, part, parts, folder / f"part-{part}.h5")
    encoded = [folder / f"part-{part}.h5" for part in range(parts)]
    with DriveWriter(folder / "drive.h5", stage="clouds", drive=DRIVE, params={"k": 6}) as whole:
        join(blocks, encoded, whole)
    return folder / "drive.h5"


def test_a_file_of_blocks_holds_what_one_written_at_once_holds(tmp_path: Path) -> None:
    with DriveWriter(tmp_path / "once.h5", stage="clouds", drive=DRIVE, params={"k": 6}) as file:
        write(file, range(7))
    made = assembled(tmp_path / "blocks", [range(2), range(2, 3), range(3, 7)], parts=3)
    with DriveReader(tmp_path / "once.h5", stage="clouds") as once, DriveReader(made, stage="clouds") as blocks:
        assert blocks.attrs == once.attrs
        for name in ("frame", "T", "K", "xyz", "image", "cls", "ptr"):
            np.testing.assert_array_equal(blocks[name], once[name], err_msg=name)
            one, other = once.dataset(name), blocks.dataset(name)
            assert dict(one.attrs) == dict(other.attrs)
            for what in ("dtype", "chunks", "compression", "compression_opts", "shuffle", "fillvalue"):
                assert getattr(one, what) == getattr(other, what), (name, what)


@pytest.mark.parametrize(
    ("spans", "parts"),
    [([range(2), range(2, 4), range(4, 7)], 3), ([range(n, n + 1) for n in range(7)], 7), ([range(7)], 2)],
    ids=["two", "one", "all"],
)
def test_neither_blocks_nor_parts_change_a_byte(tmp_path: Path, spans: list[range], parts: int) -> None:
    first = assembled(tmp_path / "a", [range(7)], parts=1)
    assert assembled(tmp_path / "b", spans, parts).read_bytes() == first.read_bytes()


def test_a_drive_without_frames_has_its_datasets(tmp_path: Path) -> None:
    with DriveReader(assembled(tmp_path, [range(0)], parts=1), stage="clouds") as file:
        assert file.shape("xyz") == (0, 3)
        assert file.shape("cls") == file.shape("image") == (0, 8, 9)
        assert file["ptr"].tolist() == [0]
        assert file["frame"].dtype == np.int32


def test_a_block_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with BlockWriter(tmp_path / "a.npz", stage="clouds", drive=DRIVE, params={}) as file:
            write(file, range(2))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not list(tmp_path.iterdir())
