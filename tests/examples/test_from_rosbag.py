"""Test examples/from_rosbag.py: recordings of each kind become what steer import reads."""

import numpy as np
import pytest

from pipeline.ingest.packets import read_values
from tests.footage.videos import convert, images_of, read, times_of
from tests.kitti_drive import SIZE, pictures


@pytest.mark.parametrize(("kind", "file"), [("", "a.bag"), ("SQLITE3", "a"), ("MCAP", "a/a.mcap")])
def test_recordings_of_ros(tmp_path, kind, file):
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="needs the extra rosbag")
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the extra rosbag")
    from rosbags.typesys import Stores, get_typestore

    from examples.from_rosbag import main

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
    options = {"times": out / "times.txt", "motion": out / "log.csv"}
    convert(tmp_path / "drives", out / "images", **options)
    drive = read(tmp_path / "drives")
    np.testing.assert_array_equal(images_of(drive), pictures(4))
    np.testing.assert_allclose(times_of(drive), [0, 0.1, 0.2, 0.3], atol=1e-6)
    values = read_values(drive.folder / "motion.csv")
    assert values["speed_mps"] == pytest.approx({0: 5, 1: 6, 2: 7, 3: 8}, abs=1e-4)
    assert values["yaw_rate_radps"] == pytest.approx({0: 0, 1: 0.1, 2: 0.2, 3: 0.3}, abs=1e-4)


@pytest.mark.real
@pytest.mark.parametrize(
    ("bag", "column"),
    [("8uc3", "wheel_rad=/steering:data"), ("joint_state", "wheel_rad=/steering:position.1")],
)
def test_recordings_from_public_reports(tmp_path, real_cases, bag, column):
    pytest.importorskip("rosbags", reason="needs the extra rosbag")
    from examples.from_rosbag import main

    main(real_cases / "ros" / bag, tmp_path / "out", "/camera/image_raw", [column])
    assert len([*(tmp_path / "out/images").iterdir()]) == 12
    assert len((tmp_path / "out/log.csv").read_text().splitlines()) == 13
