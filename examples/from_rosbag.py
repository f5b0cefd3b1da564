"""Write images and a log of a ROS 1, ROS 2 or MCAP recording for `steer import`.

This needs pip install -e '.[rosbag]'. A column of the log takes its values from a field of the
messages of a topic. An element of an array is a field named by its position, as position.1 below:

    python examples/from_rosbag.py a.mcap a /camera/image_raw \
        wheel_rad=/steering:angle speed_mps=/odom:twist.twist.linear.x
    python examples/from_rosbag.py a.db3 a /camera/image_raw wheel_rad=/joints:position.1
    steer import a/images --wheel a/log.csv --steering-ratio 14.8 --fov 65 --name monday
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
import typer
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pipeline.base import console
from pipeline.base.errors import InputError, closest
from pipeline.base.outputs import check_free
from pipeline.base.store import replacing

# Encoding of an Image message → number of its channels, and OpenCV's conversion to BGR, or None if
# no conversion is needed.
ENCODINGS = {
    "mono8": (1, None),
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    # cv_bridge gives OpenCV's images these names.
    "8UC1": (1, None),
    "8UC3": (3, None),
}
# Types of messages that hold an image.
IMAGES = {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
# Suffix of a recording → command that repairs it.
REPAIR = {".mcap": "mcap recover", ".db3": "ros2 bag reindex", ".bag": "rosbag reindex"}


class Column(NamedTuple):
    """A column of the log, given as NAME=TOPIC:FIELD."""

    text: str  # the argument as the user gave it
    name: str
    topic: str
    field: str


def main(
    bag: Path,
    out: Path,
    images: str,
    columns: list[str],
    messages: Annotated[
        Path | None, typer.Option(help="folder with PACKAGE/msg/NAME.msg of your own types")
    ] = None,
) -> None:
    """Write images to OUT/images and a log to OUT/log.csv.

    Images are named by ns since 1970. A column of the log is NAME=TOPIC:FIELD.
    """
    log_columns = parse_columns(columns)
    check_free(out)
    if not bag.exists():
        raise InputError("path is missing", bag)

    topics = {images, *(column.topic for column in log_columns)}
    rows = list[dict[str, float]]()
    with opened(bag, message_types(messages)) as reader, replacing(out) as new:
        for topic in topics.difference(reader.topics):
            raise InputError(f"has no topic {topic} ({closest(topic, sorted(reader.topics))})", bag)
        connections = [
            connection for connection in reader.connections if connection.topic in topics
        ]
        for connection in connections:
            check_type(connection, reader, images)

        # Write each image at once, and collect the values of the log.
        (new / "images").mkdir(parents=True)
        for connection, received_ns, content in reader.messages(connections):
            message: Any = reader.deserialize(content, connection.msgtype)
            time_ns = message_time_ns(message, received_ns)
            for column in log_columns:
                if column.topic == connection.topic:
                    rows.append({"time_s": time_ns, column.name: read_value(message, column)})
            if connection.topic == images:
                write_image(new / "images" / str(time_ns), message)

        # The times of the log are seconds since the first image.
        times_ns = [int(path.stem) for path in (new / "images").iterdir()]
        if not times_ns:
            raise InputError("has no message", images)
        table = pd.DataFrame(rows).sort_values("time_s")
        table["time_s"] = (table["time_s"] - min(times_ns)) / 1e9
        table.to_csv(new / "log.csv", index=False)


def parse_columns(texts: list[str]) -> list[Column]:
    """Return the columns of the log. Raises InputError."""
    columns = []
    for text in texts:
        match = re.fullmatch("(.+)=(.+):(.+)", text)
        if not match:
            raise InputError(f"expected columns as NAME=TOPIC:FIELD, got {' '.join(texts)}")
        columns.append(Column(text, *match.groups()))
    return columns


def message_types(folder: Path | None) -> Typestore:
    """Return the types of messages that ROS defines, and those that a folder defines."""
    types = get_typestore(Stores.LATEST)
    if folder:
        for path in folder.rglob("*.msg"):
            name = f"{path.parent.parent.name}/msg/{path.stem}"
            types.register(get_types_from_msg(path.read_text("utf-8"), name))
    return types


@contextmanager
def opened(bag: Path, types: Typestore) -> Iterator[AnyReader]:
    """Yield a reader of a recording. Raises InputError if the recording is no bag or incomplete."""
    try:
        with AnyReader([bag], default_typestore=types) as reader:
            yield reader
    except (AnyReaderError, FileNotFoundError) as error:
        files = sorted(path for path in bag.glob("*") if path.suffix in REPAIR)
        if "Profile" in str(error):
            fix = "It is not ROS"
        elif files:
            fix = f"Pass the file: {files[0]}"
        else:
            repair = REPAIR.get(bag.suffix, "ros2 bag reindex")
            fix = f"If its recorder was killed: {repair} {bag.name}"
        raise InputError(str(error), bag, fix) from error


def check_type(connection: Connection, reader: AnyReader, images: str) -> None:
    """Raise InputError if the messages of a topic cannot be read.

    `images` is the topic of the images.
    """
    message_type = connection.msgtype
    if connection.topic == images and message_type not in IMAGES:
        problem = f"images are {message_type}, expected {' or '.join(sorted(IMAGES))}"
        fix = "Write the data of a video's messages into one file, and pass that to steer import"
        raise InputError(problem, images, fix)
    if message_type not in reader.typestore.types:
        problem = f"the file does not define {message_type}"
        raise InputError(problem, connection.topic, "Pass --messages, its folder")


def message_time_ns(message: Any, received_ns: int) -> int:
    """Return the time of a message in its header, or the time at which it was received.

    The header's time is used only if it counts from 1970.
    """
    if hasattr(message, "header"):
        stamp = message.header.stamp
        if stamp.sec > 10**9:  # some sensors count from their start
            return stamp.sec * 10**9 + stamp.nanosec
    return received_ns


def read_value(message: Any, column: Column) -> float:
    """Return the value of a column in a message, whose field is a path such as position.1.

    Raises InputError if the message has no such field or the field is no number.
    """
    for name in column.field.split("."):
        try:
            message = message[int(name)] if name.isdecimal() else getattr(message, name)
        except (AttributeError, IndexError, TypeError) as error:
            raise InputError(f"message has no {name} ({error})", column.text) from error
    if not isinstance(message, int | float | np.number):
        problem = f"expected a number, got {message!r:.60}"
        raise InputError(problem, column.text, "Of an array, name an element: position.1")
    return float(message)


def write_image(path: Path, message: Any) -> None:
    """Write the image of a message: a CompressedImage as it is, an Image as a PNG file."""
    if hasattr(message, "format"):
        suffix = re.search("png|jpe?g", message.format)
        if not suffix:
            problem = f"images are {message.format!r}, expected png or jpeg"
            raise InputError(problem, fix="Convert them")
        path.with_suffix(f".{suffix[0]}").write_bytes(message.data.tobytes())
        return
    if message.encoding not in ENCODINGS:
        fix = f"Convert them to one of {', '.join(ENCODINGS)}"
        raise InputError(f"images are {message.encoding}", fix=fix)

    # Rows may end with padding. OpenCV writes pixels that are BGR.
    channels, to_bgr = ENCODINGS[message.encoding]
    pixels = message.data.reshape(message.height, -1)[:, : message.width * channels]
    pixels = pixels.reshape(message.height, -1, channels)
    if to_bgr is not None:
        pixels = cv2.cvtColor(pixels, to_bgr)
    cv2.imwrite(f"{path}.png", pixels)


if __name__ == "__main__":
    console.run(main)
