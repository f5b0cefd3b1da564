"""What a dataset's file may return: read rightly, noted, or refused with one line."""

import re
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.summary import split_doubts
from pipeline.camera.camera import Camera, Frame
from pipeline.ingest import validate
from pipeline.ingest.drive import Drive, load_dataset
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.packets import COLUMNS, make_packets
from pipeline.ingest.write import write_drive
from steer.measure import READING
from tests import street
from tests.kitti_drive import SIZE

K = np.array([[50, 0, 31.3], [0, 50, 22.2], [0, 0, 1]])
CAMERA = Camera(K, SIZE)
SCANNER = Camera(K, SIZE, T_cam_velo=street.T_CAM_VELO)
# Number of frames.
F = 6
ANGLES = {number: 0.01 * number for number in range(1, F + 1)}
PACKETS = dict(enumerate(make_packets(F, vf=8.0, wu=0.1), start=1))
IMAGE = np.full((*SIZE, 3), 7, np.uint8)
DEPTH = np.full(SIZE, 20.0)
SCAN = np.ones((9, 4), np.float32)


def make_drive(
    numbers: Any = range(1, F + 1),
    times: Any = np.arange(F) / 10,
    image: object = IMAGE,
    camera: Any = CAMERA,
    values: Any = None,
    angles: Any = ANGLES,
    **fields: object,
) -> Drive:
    """Return a drive of frames with an image, which are valid unless an argument says otherwise."""

    def frames() -> Iterator[Frame]:
        for number, time_s in zip(numbers, times, strict=True):
            yield Frame(number, time_s, image, **fields)

    return Drive(camera, frames, {"steering_rad": angles} if values is None else values)


def yield_frames(*frames: object) -> Drive:
    return Drive(CAMERA, lambda: iter(frames))


def angles(**changes: object) -> dict[int, object]:
    """Return the angles, with other values of some frames: angles(_2=None)."""
    return ANGLES | {int(name[1:]): value for name, value in changes.items()}


def rates(speed_mps: float, yaw_rate_radps: float) -> dict[str, dict[int, float]]:
    speeds = dict.fromkeys(ANGLES, speed_mps)
    return {"speed_mps": speeds, "yaw_rate_radps": dict.fromkeys(ANGLES, yaw_rate_radps)}


def mapped(function: Callable[[Any], object]) -> dict[object, float]:
    """Return the angles with other keys."""
    return {function(number): value for number, value in ANGLES.items()}


UNKNOWN = "steering_rad: values without a frame: 0, frames without a value: 1"


@pytest.mark.parametrize(
    ("drive", "notes"),
    [
        (make_drive(), []),
        (make_drive(numbers=np.arange(1, F + 1, dtype=np.uint8), angles=mapped(np.int64)), []),
        (make_drive(times=1.7e9 + np.arange(F) / 10), []),
        (make_drive(angles=angles(_2=None)), [UNKNOWN]),
        (make_drive(angles=angles(_2=np.nan)), [UNKNOWN]),
        (make_drive(angles=angles(_2=pd.NA)), [UNKNOWN]),
    ],
)
def test_healthy_drives(tmp_path, drive, notes):
    """Times begin at 0, and unknown angles are never valid."""
    write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    assert drive.notes == notes
    with open_ingest(tmp_path / "a.h5") as file:
        assert file.frame.tolist() == [*ANGLES]
        np.testing.assert_allclose(file.time_s, np.arange(F) / 10, atol=1e-6)
        is_known = np.array([not notes or number != 2 for number in ANGLES])
        assert file["has_steering"].tolist() == is_known.astype(int).tolist()
        np.testing.assert_allclose(file["steering_rad"], np.where(is_known, [*ANGLES.values()], 0))


@pytest.mark.parametrize(
    ("drive", "note"),
    [
        (
            make_drive(angles=mapped(lambda number: number + 1)),
            "steering_rad: values without a frame: 1, frames without a value: 1",
        ),
        (
            make_drive(values={name: {1: 0.1, 9: 0.1} for name in rates(0, 0)}),
            "speed_mps, yaw_rate_radps: values without a frame: 1, frames without a value: 5",
        ),
        (make_drive(numbers=[1, 2, 3, 5, 6, 7]), "gaps in the numbers of frames: 1"),
        (
            make_drive(times=[0, 0.1, 0.2, 0.4, 0.5, 0.6]),
            "gaps in time between neighbouring numbers: 1, the longest of 0.20 s after frame 3",
        ),
        (
            make_drive(times=[0, 0.1, 0.2, 60.2, 60.3, 60.4]),
            "gaps in time between neighbouring numbers: 1, the longest of 60.00 s after frame 3",
        ),
    ],
)
def test_gaps_are_noted(tmp_path, drive, note):
    summary = write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    assert drive.notes[0] == note
    assert summary["counts"].count(note) == 1


@pytest.mark.parametrize(
    ("numbers", "times_s", "doubt"),
    [
        # 0.14 s is the longest step of KITTI's drives, and lost frames keep their numbers.
        ([1, 2, 3, 4, 5, 6], [0, 0.1, 0.2, 0.34, 0.4, 0.5], None),
        ([1, 2, 3, 24, 25, 26], [0, 0.1, 0.2, 2.3, 2.4, 2.5], None),
        ([1, 2, 3, 4, 5, 6], [0, 0.1, 0.2, 1.2, 1.3, 1.4], None),
        ([1, 2, 3, 4, 5, 6], [0, 2, 4, 9, 11, 13], None),
        (
            [1, 2, 3, 4, 5, 6],
            [0, 0.1, 0.2, 60.3, 60.4, 60.5],
            "frames 3 and 4 are 60.1 s apart, but count as consecutive.* Leave out the numbers",
        ),
        (
            [1, 2, 3, 4, 5, 6],
            [0, 2.1, 2.2, 2.3, 2.4, 5.4],
            r"frames 5 and 6 are 3.0 s apart \(and 1 more\), but count as consecutive",
        ),
    ],
)
def test_consecutive_numbers_over_a_gap_in_time_are_doubted(tmp_path, numbers, times_s, doubt):
    drive = make_drive(numbers=numbers, times=times_s, angles=dict.fromkeys(numbers, 0.1))
    summary = write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    notes, doubts = split_doubts(drive.notes)
    assert summary["doubts"] == doubts
    assert "apart" not in " ".join([*notes, summary["counts"]])
    assert len(doubts) == (doubt is not None)
    if doubt:
        assert re.match(doubt, doubts[0])


def test_a_frame_without_a_packet(tmp_path):
    """Missing and unknown packets are rows of NaN, and so is the motion in them."""
    packets = {number: row for number, row in PACKETS.items() if number != 3} | {4: None}
    drive = make_drive(values={"oxts": packets})
    write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    assert drive.notes == ["oxts: values without a frame: 0, frames without a value: 2"]
    with open_ingest(tmp_path / "a.h5") as file:
        is_known = np.array([1, 1, 0, 0, 1, 1], bool)
        assert file["oxts"].shape == (F, len(COLUMNS))
        np.testing.assert_array_equal(np.isfinite(file["oxts"]).all(axis=1), is_known)
        np.testing.assert_array_equal(file["speed_mps"], np.where(is_known, 8.0, np.nan))


def test_unknown_depth_is_no_depth(tmp_path):
    depth_m = DEPTH.copy()
    depth_m[:, :32] = np.nan
    drive = make_drive(depth_m=depth_m)
    write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    with open_ingest(tmp_path / "a.h5") as file:
        left, right = np.split(file["depth"], 2, axis=2)
        assert not left.any()
        assert (right == 20 * 256).all()


def test_one_frame_is_in_memory_at_a_time(tmp_path):
    alive = list[weakref.ref]()

    def frames() -> Iterator[Frame]:
        for number in range(F):
            # The last one is still a variable of the loop.
            assert sum(reference() is not None for reference in alive) <= 1
            image = IMAGE.copy()
            alive.append(weakref.ref(image))
            frame = Frame(number, number / 10, image)
            del image
            yield frame
            del frame

    write_drive(tmp_path / "a.h5", Drive(CAMERA, frames), "a", "mine", READING)
    assert len(alive) == F


def with_camera(K: Any = K, size: Any = SIZE, **fields: Any) -> Drive:
    return make_drive(camera=Camera(K, size, **fields))


WRONG: list[tuple[Any, str]] = [
    # the drive
    (None, "open_drive returned a NoneType, expected a Drive"),
    (Drive(CAMERA, [Frame(0, 0.0)]), r"Drive\.frames is a list, expected a Callable"),  # type: ignore[arg-type]
    (Drive(CAMERA, lambda: None), r"Drive\.frames\(\) returned a NoneType"),  # type: ignore[arg-type, return-value]
    (yield_frames((0, 0.0)), r"Drive\.frames\(\) yielded a tuple, expected a Frame"),
    (yield_frames(), "drive has no frames"),
    (make_drive(camera=None), r"Drive\.camera is a NoneType, expected a Camera"),
    (with_camera(K[:2]), r"Camera\.K is float64 \[2, 3\], expected \[3, 3\] finite numbers"),
    (with_camera(K * np.nan), r"Camera\.K is float64 \[3, 3\], expected"),
    (with_camera(K * 2), "Camera.K: implausible intrinsics of 64 x 48 pixels"),
    (with_camera(size=[*SIZE]), r"Camera\.size is \[48, 64\], expected a tuple of two ints"),
    (with_camera(height_m=-1.6), r"Camera\.height_m is -1\.6, expected metres above 0"),
    (with_camera(horizon=np.nan), r"Camera\.horizon is nan, expected a row"),
    (with_camera(T_cam_velo=np.eye(3)), r"Camera\.T_cam_velo is float64 \[3, 3\], expected"),
    # values
    (make_drive(values=[]), r"Drive\.values is a list, expected a Mapping"),
    (make_drive(values={"speed_mp": {}}), r"unknown name speed_mp: did you mean speed_mps\?"),
    (make_drive(angles=pd.Series(ANGLES)), r"Drive\.values\['steering_rad'\] is a Series"),
    (make_drive(angles=mapped(str)), "steering_rad has 6 keys that are not ints, such as '1'"),
    (make_drive(angles=mapped(float)), "steering_rad has 6 keys that are not ints, such as 1.0"),
    (make_drive(angles={True: 0.1}), "keys that are not ints, such as True"),
    (make_drive(angles=angles(_3="0.03")), "steering_rad is not a number: '0.03' in frame 3"),
    (make_drive(angles=angles(_3=True)), "steering_rad is not a number: True in frame 3"),
    (make_drive(angles=angles(_3=[0.03])), "steering_rad is not a number: .0.03. in frame 3"),
    (make_drive(angles=angles(_3=np.inf)), "steering_rad is implausible .*: inf in frame 3"),
    (
        make_drive(angles={number: np.degrees(rad) for number, rad in ANGLES.items()}),
        r"steering_rad is implausible \(limit ±1\.2\): 1\.7\d* in frame 3 and 3 more",
    ),
    (
        make_drive(values=rates(101, -3.1)),
        "speed_mps is implausible .*; yaw_rate_radps is implausible .* -3.1 in frame 1 and 5 more",
    ),
    (make_drive(values={"speed_mps": ANGLES}), "speed_mps and yaw_rate_radps need each other"),
    (make_drive(values={"oxts": {1: [8.0] * 29}}), "oxts is not a packet of 30 numbers"),
    (make_drive(values={"oxts": {1: ["8"] * 30}}), "oxts is not a packet of 30 numbers"),
    (make_drive(values={"oxts": {1: [[1], 2]}}), "oxts is not a packet of 30 numbers"),
    (make_drive(values={"oxts": {1: PACKETS[1] * 36}}), "speed_mps is implausible .* 288.0"),
    (
        make_drive(angles=mapped(lambda number: number + 70)),
        "steering_rad has values of frames 71 to 76, expected 1 to 6",
    ),
    # numbers and times
    (make_drive(numbers=[1, 2, 3, 3, 5, 6]), "frame 3 follows frame 3: numbers do not ascend"),
    (make_drive(numbers=[0, 1, 10, 11, 2, 3]), "frame 2 follows frame 11"),
    (make_drive(numbers=np.arange(F) + 2**31), "the number .*2147483648.*, expected an int from 0"),
    (make_drive(numbers=range(-1, F - 1)), "a frame has the number -1, expected an int from 0"),
    (make_drive(numbers=mapped(str)), "a frame has the number '1', expected an int"),
    (make_drive(numbers=mapped(float)), "a frame has the number 1.0, expected an int"),
    (make_drive(times=[0, 0.1, 0.1, 0.3, 0.4, 0.5]), "time does not ascend: 0.1 s in frame 2, 0.1"),
    (make_drive(times=[0, np.nan, 0.2, 0.3, 0.4, 0.5]), "frame 2 has the time nan"),
    (make_drive(times=[None] * F), "frame 1 has the time None, expected seconds"),
    (make_drive(times=pd.date_range("2026", periods=F)), "frame 1 has the time Timestamp"),
    (make_drive(times=np.arange(F).astype("m8[s]")), "frame 1 has the time np.timedelta64"),
    (make_drive(times=np.arange(F) * 100), "median step between frames is 100, expected 0.005 to"),
    (make_drive(times=np.arange(F) * 0.004), "median step between frames is 0.004, expected"),
    # fields of frames
    (make_drive(image=(IMAGE / 255).astype(np.float32)), r"image of frame 1 is float32 \[48, 64, "),
    (make_drive(image=IMAGE[..., 0]), r"uint8 \[48, 64\], expected RGB uint8 \[H,W,3\]"),
    (make_drive(image=IMAGE[..., [0, 1, 2, 2]]), r"image of frame 1 is uint8 \[48, 64, 4\]"),
    (make_drive(image=IMAGE.astype(np.int64)), r"image of frame 1 is int64 \[48, 64, 3\]"),
    (make_drive(image=IMAGE.tolist()), "image of frame 1 is a list, expected RGB uint8"),
    (
        with_camera(size=(96, 128)),
        r"image of frame 1 has 64 x 48 pixels, expected 128 x 96, the size of Drive\.camera",
    ),
    (make_drive(depth_m=DEPTH.astype(np.uint16)), r"depth_m of frame 1 is uint16 \[48, 64\]"),
    (make_drive(depth_m=DEPTH[:9]), "depth_m of frame 1 has 64 x 9 pixels"),
    (make_drive(depth_m=-DEPTH), "depth_m of frame 1 is negative or infinite"),
    (make_drive(depth_m=DEPTH * np.inf), "depth_m of frame 1 is negative or infinite"),
    (make_drive(depth_m=DEPTH * 1000), r"depth_m of frame 1 has a median of 20000 \(limit 256 m\)"),
    (make_drive(cls=DEPTH), r"cls of frame 1 is float64 \[48, 64\], expected trainIds uint8"),
    (make_drive(cls=IMAGE), r"cls of frame 1 is uint8 \[48, 64, 3\]"),
    (make_drive(cls=IMAGE[..., 0] + 12), "cls of frame 1 has class 19, expected trainIds"),
    (make_drive(scan=SCAN), r"scan of frame 1 needs .*Camera\.T_cam_velo"),
    (make_drive(camera=SCANNER, scan=SCAN.astype(float)), r"scan of frame 1 is float64 \[9, 4\]"),
    (make_drive(camera=SCANNER, scan=SCAN[:, :3]), r"scan of frame 1 is float32 \[9, 3\]"),
    (make_drive(camera=SCANNER, scan=SCAN * 200), "reflectance beyond 0 to 1"),
]


@pytest.mark.parametrize(("drive", "problem"), WRONG)
def test_a_wrong_file_of_a_dataset(tmp_path, drive, problem):
    with pytest.raises(InputError, match=problem):
        write_drive(tmp_path / "a.h5", drive, "a", "mine", READING)
    assert not (tmp_path / "a.h5").exists()


def test_a_file_without_a_function_of_the_interface(monkeypatch):
    monkeypatch.delattr("pipeline.ingest.datasets.folders.open_drive")
    with pytest.raises(InputError, match=r"folders\.py: has no function open_drive"):
        load_dataset("folders")


@pytest.mark.parametrize(
    ("steps_s", "train", "doubt"),
    [
        ({"a": 0.1, "b": 0.11}, ["a"], None),
        ({"a": 0.1, "b": 0.2}, ["a"], "the usual rate is 10.0 frames/s, but b 5.0"),
        ({"a": 0.1, "b": 0.1, "c": 0.04}, [], "the usual rate is 10.0 frames/s, but c 25.0"),
        ({"a": None, "b": 0.1}, ["a"], None),
        ({"a": None}, ["a"], None),
    ],
)
def test_another_frame_rate_is_doubted(steps_s, train, doubt):
    text = validate.rate_doubt(steps_s, train)
    assert text == (doubt and f"doubt: {doubt}")
