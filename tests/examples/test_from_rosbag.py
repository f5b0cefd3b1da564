"""Test examples/from_rosbag.py: a bag becomes images, their times and a log."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.camera.images import read_image
from tests.kitti_drive import SIZE, pictures

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
NUMBER = "std_msgs/msg/Float64"
# The type of a topic, and functions that make its messages of ROS's types.
Topic = tuple[str, Sequence[Callable[[Any], object]]]


def write_bag(folder: Path, topics: Mapping[str, Topic], kind: str = "SQLITE3") -> None:
    """Write topic → type and messages, each made of the types of a store."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the extra rosbag")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    storage = rosbag2.StoragePlugin[kind]
    with rosbag2.Writer(folder, version=9, storage_plugin=storage) as writer:
        for topic, (message_type, messages) in topics.items():
            connection = writer.add_connection(topic, message_type, typestore=store)
            for row, make in enumerate(messages):
                data = store.serialize_cdr(make(store.types), message_type)
                writer.write(connection, 17 * 10**17 + row * 10**8, data)


@pytest.mark.parametrize(("kind", "file"), [("SQLITE3", "a"), ("MCAP", "a/a.mcap")])
def test_recordings_of_ros(tmp_path, kind, file):
    def image(row: int, pixels: np.ndarray) -> Callable[[Any], object]:
        def make(types: Any) -> object:
            stamp = types["builtin_interfaces/msg/Time"](17 * 10**8, row * 10**8)
            header = types["std_msgs/msg/Header"](stamp, "")
            step = 3 * SIZE[1]
            return types[IMAGE](header, *SIZE, "rgb8", 0, step, pixels.ravel())

        return make

    def number(row: int) -> Callable[[Any], object]:
        return lambda types: types[NUMBER](5.0 + row)

    topics = {
        "/image": (IMAGE, [image(row, pixels) for row, pixels in enumerate(pictures(4))]),
        "/speed": (NUMBER, [number(row) for row in range(4)]),
    }
    write_bag(tmp_path / "a", topics, kind)
    from examples.from_rosbag import main

    out = tmp_path / "out"
    main(tmp_path / file, out, "/image", ["speed_mps=/speed:data"])
    images = [read_image(path) for path in sorted((out / "images").iterdir())]
    np.testing.assert_array_equal(images, pictures(4))
    times_s = np.loadtxt(out / "times.txt")
    np.testing.assert_allclose(times_s - 17e8, [0, 0.1, 0.2, 0.3], atol=1e-6)
    log = pd.read_csv(out / "log.csv")
    np.testing.assert_allclose(log["time_s"], times_s)
    assert log["speed_mps"].tolist() == [5, 6, 7, 8]


def make_header(types: Any) -> object:
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")


def image_of(encoding: str, channels: int) -> Topic:
    pixels = np.zeros(SIZE[0] * SIZE[1] * channels, np.uint8)
    step = SIZE[1] * channels
    return IMAGE, [lambda types: types[IMAGE](make_header(types), *SIZE, encoding, 0, step, pixels)]


def compressed(kind: str) -> Topic:
    content = np.frombuffer(b"\0\0\0\x01\x67", np.uint8)
    return COMPRESSED, [lambda types: types[COMPRESSED](make_header(types), kind, content)]


EMPTY: Topic = (NUMBER, [])
NUMBERS: Topic = (NUMBER, [lambda types: types[NUMBER](5.0)])


@pytest.mark.parametrize(
    ("images", "numbers", "problem"),
    [
        (image_of("rgba8", 4), NUMBERS, "/image is rgba8: expected rgb8, bgr8, mono8"),
        (image_of("bayer_rggb8", 1), NUMBERS, "/image is bayer_rggb8: expected"),
        (image_of("mono16", 2), NUMBERS, "/image is mono16: expected"),
        (compressed("h264"), NUMBERS, "/image is 'h264': expected JPEG or PNG"),
        (EMPTY, NUMBERS, "topic /image has no messages"),
        (image_of("mono8", 1), EMPTY, "topic /speed has no messages"),
    ],
)
def test_plainly_wrong_topics(tmp_path, images, numbers, problem):
    write_bag(tmp_path / "a", {"/image": images, "/speed": numbers})
    from examples.from_rosbag import main

    with pytest.raises(SystemExit, match=problem):
        main(tmp_path / "a", tmp_path / "out", "/image", ["speed_mps=/speed:data"])
    assert not (tmp_path / "out/times.txt").exists()


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
