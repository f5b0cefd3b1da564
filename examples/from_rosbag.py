"""Write images and a log of a ROS 1, ROS 2 or MCAP recording for `steer import`. Needs pip install
-e '.[rosbag]'.

python examples/from_rosbag.py a.mcap a /camera/image_raw wheel_rad=/steering:angle
speed_mps=/odom:twist.twist.linear.x python examples/from_rosbag.py a.db3 a /camera/image_raw
wheel_rad=/joints:position.1   # the second of an array steer import a/images --wheel a/log.csv
--steering-ratio 14.8 --fov 65 --name monday
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import pandas as pd
import typer
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.base import console
from pipeline.base.errors import InputError, closest
from pipeline.base.outputs import check_free
from pipeline.base.store import replacing

ENCODINGS = {
    "mono8": (1, None),
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
}
ENCODINGS |= {
    f"bayer_{x}8": (1, getattr(cv2, f"COLOR_Bayer{x.upper()}2BGR"))
    for x in ("rggb", "bggr", "grbg", "gbrg")
}
# as cv_bridge writes OpenCV's images
ENCODINGS |= {"8UC1": ENCODINGS["mono8"], "8UC3": ENCODINGS["bgr8"]}
IMAGES = {f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage")}
REPAIR = {".mcap": "mcap recover", ".db3": "ros2 bag reindex", ".bag": "rosbag reindex"}


def main(
    bag: Path,
    out: Path,
    images: str,
    columns: list[str],
    messages: Annotated[
        Path | None, typer.Option(help="folder with PACKAGE/msg/NAME.msg of your own types")
    ] = None,
) -> None:
    """Write OUT/images, named by ns since 1970, and OUT/log.csv, by its columns as
    NAME=TOPIC:FIELD.
    """
    if not all(fields := [re.fullmatch("(.+)=(.+):(.+)", column) for column in columns]):
        raise InputError(f"expected columns as NAME=TOPIC:FIELD, got {' '.join(columns)}")
    check_free(out)
    if not bag.exists():
        raise InputError("path is missing", bag)
    types, rows, topics = (
        get_typestore(Stores.LATEST),
        list[dict[str, float]](),
        {images, *(f[2] for f in fields)},
    )
    for path in messages.rglob("*.msg") if messages else ():
        types.register(
            get_types_from_msg(
                path.read_text("utf-8"), f"{path.parent.parent.name}/msg/{path.stem}"
            )
        )
    with opened(bag, types) as reader, replacing(out) as new:
        for topic in topics.difference(reader.topics):
            raise InputError(f"has no topic {topic} ({closest(topic, sorted(reader.topics))})", bag)
        (new / "images").mkdir(parents=True)
        used = [one for one in reader.connections if one.topic in topics]
        for one in used:
            if one.topic == images and one.msgtype not in IMAGES:
                fix = (
                    "Write the data of a video's messages into one file, and pass that to steer "
                    "import"
                )
                raise InputError(
                    f"images are {one.msgtype}, expected {' or '.join(sorted(IMAGES))}", images, fix
                )
            if one.msgtype not in reader.typestore.types:
                raise InputError(
                    f"the file does not define {one.msgtype}",
                    one.topic,
                    "Pass --messages, its folder",
                )
        for source, received_ns, content in reader.messages(used):
            message: Any = reader.deserialize(content, source.msgtype)
            stamp = message.header.stamp if hasattr(message, "header") else None
            time_ns = (
                stamp.sec * 10**9 + stamp.nanosec if stamp and stamp.sec > 10**9 else received_ns
            )
            rows += [
                {"time_s": time_ns, f[1]: value(message, f[3], f[0])}
                for f in fields
                if f[2] == source.topic
            ]
            if source.topic == images:
                write_image(new / "images" / str(time_ns), message)
        if not (times_ns := [int(path.stem) for path in (new / "images").iterdir()]):
            raise InputError("has no message", images)
        table = pd.DataFrame(rows).sort_values("time_s")
        table["time_s"] = (table["time_s"] - min(times_ns)) / 1e9
        table.to_csv(new / "log.csv", index=False)


@contextmanager
def opened(bag: Path, types: Any) -> Iterator[AnyReader]:
    """Yield a reader. Raises InputError if the recording is no bag, or incomplete."""
    try:
        with AnyReader([bag], default_typestore=types) as reader:
            yield reader
    except (AnyReaderError, FileNotFoundError) as error:
        inside = sorted(path for path in bag.glob("*") if path.suffix in REPAIR)
        repair = REPAIR.get(bag.suffix, "ros2 bag reindex")
        fix = (
            f"Pass the file: {inside[0]}"
            if inside
            else f"If its recorder was killed: {repair} {bag.name}"
        )
        raise InputError(
            str(error), bag, "It is not ROS" if "Profile" in str(error) else fix
        ) from error


def value(message: Any, field: str, column: str) -> float:
    """Return the number at a dotted path of names and positions. Raises InputError."""
    for name in field.split("."):
        try:
            message = message[int(name)] if name.isdecimal() else getattr(message, name)
        except (AttributeError, IndexError, TypeError) as error:
            raise InputError(f"message has no {name} ({error})", column) from error
    if not isinstance(message, int | float | np.number):
        raise InputError(
            f"expected a number, got {message!r:.60}",
            column,
            "Of an array, name an element: position.1",
        )
    return float(message)


def write_image(path: Path, message: Any) -> None:
    """Write a CompressedImage as it is, an Image as PNG, converted to BGR."""
    if hasattr(message, "format"):
        if not (kind := re.search("png|jpe?g", message.format)):
            raise InputError(
                f"images are {message.format!r}, expected png or jpeg", fix="Convert them"
            )
        path.with_suffix(f".{kind[0]}").write_bytes(message.data.tobytes())
        return
    if message.encoding not in ENCODINGS:
        raise InputError(
            f"images are {message.encoding}", fix=f"Convert them to one of {', '.join(ENCODINGS)}"
        )
    channels, to_bgr = ENCODINGS[message.encoding]
    # without padding
    pixels = message.data.reshape(message.height, -1)[:, : message.width * channels]
    pixels = pixels.reshape(message.height, -1, channels)
    cv2.imwrite(f"{path}.png", pixels if to_bgr is None else cv2.cvtColor(pixels, to_bgr))


if __name__ == "__main__":
    console.run(main)
