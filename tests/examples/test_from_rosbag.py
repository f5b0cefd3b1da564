"""Test examples/from_rosbag.py: recordings of each kind become what steer import reads."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.ingest.recording import open_recording
from pipeline.ingest.settings import RecordingOptions
from tests.kitti_drive import SIZE, pictures, write


@pytest.mark.parametrize(("kind", "file"), [("", "a.bag"), ("SQLITE3", "a"), ("MCAP", "a/a.mcap")])
def test_recordings_of_ros(tmp_path, kind, file):
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="needs the extra rosbag")
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the extra rosbag")
    from examples.from_rosbag import Stores, get_typestore, main

    bag = tmp_path / file.split("/")[0]
    if kind:
        store = get_typestore(Stores.ROS2_HUMBLE)
        serialize = store.serialize_cdr
        bag_writer = rosbag2.Writer(bag, version=9, storage_plugin=rosbag2.StoragePlugin[kind])
    else:
        store = get_typestore(Stores.ROS1_NOETIC)
        serialize = store.serialize_ros1
        bag_writer = rosbag1.Writer(bag)
    image_type = "sensor_msgs/msg/Image"
    number_type = "std_msgs/msg/Float64"

    def image(row: int, pixels: np.ndarray) -> object:
        stamp = store.types["builtin_interfaces/msg/Time"](17 * 10**8, row * 10**8)
        header = {"stamp": stamp, "frame_id": ""}
        if not kind:
            header["seq"] = row
        header = store.types["std_msgs/msg/Header"](**header)
        return store.types[image_type](header, *SIZE, "rgb8", 0, 3 * SIZE[1], pixels.ravel())

    number = store.types[number_type]
    topics = {
        "/image": (image_type, [image(row, pixels) for row, pixels in enumerate(pictures(4))]),
        "/speed": (number_type, [number(5.0 + row) for row in range(4)]),
        "/yaw": (number_type, [number(row / 10) for row in range(4)]),
    }
    with bag_writer as writer:
        for topic, (message_type, messages) in topics.items():
            connection = writer.add_connection(topic, message_type, typestore=store)
            for row, message in enumerate(messages):
                data = serialize(message, message_type)
                writer.write(connection, 17 * 10**17 + row * 10**8, data)

    out = tmp_path / "out"
    main(tmp_path / file, out, "/image", ["speed_mps=/speed:data", "yaw_rate_radps=/yaw:data"])
    recording = open_recording([out / "images"], RecordingOptions(fov=80, motion=out / "log.csv"))
    speed_mps, yaw_rate_radps = recording.logs["motion"].at(recording.times_s)
    np.testing.assert_allclose(speed_mps, [5, 6, 7, 8])
    np.testing.assert_allclose(yaw_rate_radps, [0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal([frame.image for frame in recording.frames()], pictures(4))


@pytest.fixture
def own_types(tmp_path: Path) -> Path:
    """Return a folder with the definition of a type that a recording does not hold."""
    report = "std_msgs/Header header\nfloat32 steering_wheel_angle\nfloat32 speed\n"
    write(tmp_path / "types/dbw_mkz_msgs/msg/SteeringReport.msg", report)
    return tmp_path / "types"


@pytest.mark.real
# rosbags leaves damaged files open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("bag", "column", "problem"),
    [
        (
            "before_iron",
            "wheel_rad=/steering:steering_wheel_angle",
            "file does not define dbw_mkz_msgs/.*--messages",
        ),
        (
            "joint_state",
            "wheel_rad=/steering:position",
            r"expected a number, got array.*position\.1",
        ),
        ("joint_state", "wheel_rad=/steering:angle", "message has no angle"),
        (
            "compressed_video.mcap",
            "wheel_rad=/steering:data",
            "images are foxglove_msgs/msg/CompressedVideo",
        ),
        ("cut.mcap", "wheel_rad=/steering:data", "mcap recover cut.mcap"),
        ("cut.db3", "wheel_rad=/steering:data", "ros2 bag reindex cut.db3"),
        ("unindexed.bag", "wheel_rad=/steering:data", "rosbag reindex unindexed.bag"),
        ("proto.mcap", "wheel_rad=/steering:data", "It is not ROS"),
        ("8uc3/..", "wheel_rad=/steering:data", r"Pass the file: .*/compressed_video\.mcap"),
    ],
)
def test_faulty_recordings_from_public_reports(tmp_path, real_cases, bag, column, problem):
    pytest.importorskip("rosbags", reason="needs the extra rosbag")
    from examples.from_rosbag import main

    with pytest.raises(InputError, match=problem):
        main(real_cases / "ros" / bag, tmp_path / "out", "/camera/image_raw", [column])
    assert not (tmp_path / "out").exists()


@pytest.mark.real
@pytest.mark.parametrize(
    ("bag", "column"),
    [
        ("8uc3", "wheel_rad=/steering:data"),
        ("joint_state", "wheel_rad=/steering:position.1"),
        ("before_iron", "wheel_rad=/steering:steering_wheel_angle"),
    ],
)
def test_recordings_from_public_reports(tmp_path, real_cases, own_types, bag, column):
    pytest.importorskip("rosbags", reason="needs the extra rosbag")
    from examples.from_rosbag import main

    out = tmp_path / "out"
    main(real_cases / "ros" / bag, out, "/camera/image_raw", [column], own_types)
    assert len([*(out / "images").iterdir()]) == 12
    assert len((out / "log.csv").read_text().splitlines()) == 13
