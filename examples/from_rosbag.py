"""Write images and a log of a ROS 1, ROS 2 or MCAP recording for `steer import`. Needs pip install -e '.[rosbag]'.

python examples/from_rosbag.py a.mcap a /camera/image_raw wheel_rad=/steering:angle speed_mps=/odom:twist.twist.linear.x
steer import a/images --wheel a/log.csv --steering-ratio 14.8 --fov 65 --drive 2027_03_31_drive_0001
"""

import re
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import pandas as pd
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pipeline.base import console
from pipeline.base.errors import InputError, closest

ENCODINGS = {"mono8": (1, None), "bgr8": (3, None), "rgb8": (3, cv2.COLOR_RGB2BGR), "bgra8": (4, cv2.COLOR_BGRA2BGR)}
ENCODINGS |= {f"bayer_{x}8": (1, getattr(cv2, f"COLOR_Bayer{x.upper()}2BGR")) for x in ("rggb", "bggr", "grbg", "gbrg")}


def main(bag: Path, out: Path, images: str, columns: list[str]) -> None:
    """Write OUT/images, named by ns since 1970, and OUT/log.csv, by its columns as NAME=TOPIC:FIELD."""
    if not all(fields := [re.fullmatch("(.+)=(.+):(.+)", column) for column in columns]):
        raise InputError(f"expected columns as NAME=TOPIC:FIELD, got {' '.join(columns)}")
    rows, topics = list[dict[str, float]](), {images, *(field[2] for field in fields)}
    with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for topic in topics.difference(reader.topics):
            raise InputError(f"has no topic {topic} ({closest(topic, sorted(reader.topics))})", bag)
        (out / "images").mkdir(parents=True)
        for source, received_ns, content in reader.messages([one for one in reader.connections if one.topic in topics]):
            message: Any = reader.deserialize(content, source.msgtype)
            stamp = message.header.stamp if hasattr(message, "header") else None
            time_ns = stamp.sec * 10**9 + stamp.nanosec if stamp and stamp.sec > 10**9 else received_ns
            rows += [{"time_s": time_ns, f[1]: attrgetter(f[3])(message)} for f in fields if f[2] == source.topic]
            if source.topic == images:
                write_image(out / "images" / str(time_ns), message)
    first_ns = min(int(path.stem) for path in (out / "images").iterdir())
    table = pd.DataFrame(rows).sort_values("time_s")
    table["time_s"] = (table["time_s"] - first_ns) / 1e9
    table.to_csv(out / "log.csv", index=False, mode="x")


def write_image(path: Path, message: Any) -> None:
    """Write a CompressedImage as it is, an Image as PNG, converted to BGR."""
    if hasattr(message, "format"):
        path.with_suffix(".png" if "png" in message.format else ".jpg").write_bytes(message.data.tobytes())
        return
    if message.encoding not in ENCODINGS:
        raise InputError(f"images are {message.encoding}", fix=f"Convert them to one of {', '.join(ENCODINGS)}")
    channels, to_bgr = ENCODINGS[message.encoding]
    pixels = message.data.reshape(message.height, -1)[:, : message.width * channels]  # without padding
    pixels = pixels.reshape(message.height, -1, channels)
    cv2.imwrite(f"{path}.png", pixels if to_bgr is None else cv2.cvtColor(pixels, to_bgr))


if __name__ == "__main__":
    console.run(main)
