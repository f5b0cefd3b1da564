"""examples/from_rosbag.py: recordings of each kind become what steer import reads."""

from contextlib import nullcontext

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.ingest.recording import open_recording
from pipeline.ingest.settings import RecordingOptions
from tests.kitti_drive import SIZE, pictures, write


@pytest.mark.parametrize(("kind", "file"), [("", "a.bag"), ("SQLITE3", "a"), ("MCAP", "a/a.mcap")])
def test_recordings_of_ros(tmp_path, kind, file):
    bags = [
        pytest.importorskip(f"rosbags.rosbag{number}", reason="needs the extra rosbag")
        for number in (1, 2)
    ]
    from examples.from_rosbag import Stores, get_typestore, main

    ros1, number = not kind, "std_msgs/msg/Float64"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    options = {"version": 9, "storage_plugin": bags[1].StoragePlugin[kind]} if kind else {}
    with bags[not ros1].Writer(tmp_path / file.split("/")[0], **options) as writer:
        for topic, name in {
            "/image": "sensor_msgs/msg/Image",
            "/speed": number,
            "/yaw": number,
        }.items():
            connection = writer.add_connection(topic, name, typestore=store)
            for row, pixels in enumerate(pictures(4)):
                values = {"/speed": [5.0 + row], "/yaw": [row / 10]}.get(topic)
                head = header(*[row] * ros1, stamp=time(17 * 10**8, row * 10**8), frame_id="")
                values = values or [head, *SIZE, "rgb8", 0, 3 * SIZE[1], pixels.ravel()]
                data = (store.serialize_ros1 if ros1 else store.serialize_cdr)(
                    store.types[name](*values), name
                )
                writer.write(connection, 17 * 10**17 + row * 10**8, data)
    main(
        tmp_path / file,
        tmp_path / "out",
        "/image",
        ["speed_mps=/speed:data", "yaw_rate_radps=/yaw:data"],
    )
    recording = open_recording(
        [tmp_path / "out/images"], RecordingOptions(fov=80, motion=tmp_path / "out/log.csv")
    )
    np.testing.assert_allclose(
        recording.logs["motion"].at(recording.times_s), [[5, 6, 7, 8], [0, 0.1, 0.2, 0.3]]
    )
    np.testing.assert_array_equal([frame.image for frame in recording.frames()], pictures(4))


@pytest.mark.real
# rosbags leaves damaged files open
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
        ("8uc3", "wheel_rad=/steering:data", ""),
        ("joint_state", "wheel_rad=/steering:position.1", ""),
        ("before_iron", "wheel_rad=/steering:steering_wheel_angle", ""),
    ],
)
def test_recordings_from_public_reports(tmp_path, real_cases, bag, column, problem):
    pytest.importorskip("rosbags", reason="needs the extra rosbag")
    from examples.from_rosbag import main

    report = "std_msgs/Header header\nfloat32 steering_wheel_angle\nfloat32 speed\n"
    write(tmp_path / "dbw_mkz_msgs/msg/SteeringReport.msg", report)
    out, types = tmp_path / "out", None if problem else tmp_path
    with pytest.raises(InputError, match=problem) if problem else nullcontext():
        main(real_cases / "ros" / bag, out, "/camera/image_raw", [column], types)
    assert out.exists() == (not problem)
    if not problem:
        assert len([*(out / "images").iterdir()]) == 12
        assert len((out / "log.csv").read_text().splitlines()) == 13
