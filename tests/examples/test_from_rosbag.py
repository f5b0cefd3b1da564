"""Test examples/from_rosbag.py: a bag becomes images, their times and a log."""

import numpy as np
import pandas as pd
import pytest

from pipeline.camera.images import read_image
from tests.kitti_drive import SIZE, pictures


@pytest.mark.parametrize(("kind", "file"), [("SQLITE3", "a"), ("MCAP", "a/a.mcap")])
def test_recordings_of_ros(tmp_path, kind, file):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the extra rosbag")
    from rosbags.typesys import Stores, get_typestore

    from examples.from_rosbag import main

    store = get_typestore(Stores.ROS2_HUMBLE)
    image_type = "sensor_msgs/msg/Image"
    number_type = "std_msgs/msg/Float64"

    def image(row: int, pixels: np.ndarray) -> object:
        stamp = store.types["builtin_interfaces/msg/Time"](17 * 10**8, row * 10**8)
        header = store.types["std_msgs/msg/Header"](stamp, "")
        return store.types[image_type](header, *SIZE, "rgb8", 0, 3 * SIZE[1], pixels.ravel())

    number = store.types[number_type]
    topics = {
        "/image": (image_type, [image(row, pixels) for row, pixels in enumerate(pictures(4))]),
        "/speed": (number_type, [number(5.0 + row) for row in range(4)]),
    }
    storage = rosbag2.StoragePlugin[kind]
    with rosbag2.Writer(tmp_path / "a", version=9, storage_plugin=storage) as writer:
        for topic, (message_type, messages) in topics.items():
            connection = writer.add_connection(topic, message_type, typestore=store)
            for row, message in enumerate(messages):
                data = store.serialize_cdr(message, message_type)
                writer.write(connection, 17 * 10**17 + row * 10**8, data)

    out = tmp_path / "out"
    main(tmp_path / file, out, "/image", ["speed_mps=/speed:data"])
    images = [read_image(path) for path in sorted((out / "images").iterdir())]
    np.testing.assert_array_equal(images, pictures(4))
    times_s = np.loadtxt(out / "times.txt")
    np.testing.assert_allclose(times_s - 17e8, [0, 0.1, 0.2, 0.3], atol=1e-6)
    log = pd.read_csv(out / "log.csv")
    np.testing.assert_allclose(log["time_s"], times_s)
    assert log["speed_mps"].tolist() == [5, 6, 7, 8]


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
