"""Write images, their times and a log of a ROS 1, ROS 2 or MCAP bag for `steer import`.

This needs pip install -e '.[rosbag]'. A column of the log is NAME=TOPIC:FIELD:

    python examples/from_rosbag.py a.mcap a /camera/image_raw wheel_rad=/joints:position.1
    steer import a/images --times a/times.txt --wheel a/log.csv --steering-ratio 14.8 --fov 65
"""

import re
import sys
from pathlib import Path
from typing import Any

import cv2
import pandas as pd
import typer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

# Encoding of an Image → number of its channels. OpenCV's own names stand for BGR and grey.
CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "8UC3": 3, "8UC1": 1}


def main(bag: Path, out: Path, images: str, columns: list[str]) -> None:
    """Write the images of topic IMAGES to OUT/images, OUT/times.txt, and COLUMNS to OUT/log.csv."""
    times_s = []
    rows = []
    filled = set()
    with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
        topics = {images, *(re.split("[=:]", column)[1] for column in columns)}
        if missing := topics - reader.topics.keys():
            sys.exit(f"{bag} has no topic {min(missing)} (it has {', '.join(reader.topics)})")
        for connection, received_ns, content in reader.messages():
            message: Any = reader.deserialize(content, connection.msgtype)
            time_s = received_ns / 1e9
            if hasattr(message, "header"):
                time_s = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
            filled.add(connection.topic)
            if connection.topic == images:
                suffix, image = encode_image(message, images)
                path = out / f"images/{len(times_s):06d}{suffix}"
                path.parent.mkdir(parents=True, exist_ok=bool(times_s))
                path.write_bytes(image)
                times_s.append(time_s)
            for column in columns:
                name, _, source = column.partition("=")
                topic, _, field = source.partition(":")
                if topic == connection.topic:
                    rows.append({"time_s": time_s, name: read_field(message, field)})
    if empty := topics - filled:
        sys.exit(f"{bag}: topic {min(empty)} has no messages")

    pd.Series(times_s).to_csv(out / "times.txt", header=False, index=False, float_format="%.6f")
    log = pd.DataFrame(rows).sort_values("time_s")
    log.to_csv(out / "log.csv", index=False, float_format="%.6f")


def read_field(message: Any, field: str) -> float:
    """Return the value of a field, such as twist.linear.x, or position.1 of an array."""
    for name in field.split("."):
        message = message[int(name)] if name.isdecimal() else getattr(message, name)
    return float(message)


def encode_image(message: Any, topic: str) -> tuple[str, bytes]:
    """Return the suffix and the content of a file: a CompressedImage as it is, an Image as PNG."""
    if hasattr(message, "format"):
        content = message.data.tobytes()
        for suffix, first in ((".png", b"\x89PNG"), (".jpg", b"\xff\xd8")):
            if content.startswith(first):
                return suffix, content
        sys.exit(f"{topic} is {message.format!r}: expected JPEG or PNG. Decode it, e.g. by ffmpeg")
    if message.encoding not in CHANNELS:
        known = ", ".join(CHANNELS)
        sys.exit(f"{topic} is {message.encoding}: expected {known}. Convert it, e.g. by cv_bridge")
    channels = CHANNELS[message.encoding]
    rows = message.data.reshape(message.height, message.step)[:, : message.width * channels]
    pixels = rows.reshape(message.height, message.width, channels)
    if message.encoding == "rgb8":
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    _, content = cv2.imencode(".png", pixels)
    return ".png", content.tobytes()


if __name__ == "__main__":
    typer.run(main)
