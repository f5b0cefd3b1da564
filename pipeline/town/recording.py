"""A drive's oxts: its files as recorded or as a drawn drive would have them, and what they say."""

from dataclasses import dataclass

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.oxts import COUNTS, read_row, read_times
from pipeline.kitti.raw import RawDrive


@dataclass(frozen=True)
class Recording:
    """rows [F,30] as :data:`pipeline.kitti.oxts.COLUMNS`, time_s [F] since the first frame, and the files' contents."""

    rows: np.ndarray
    time_s: np.ndarray
    packets: dict[int, bytes]  # frame number -> its oxts file
    timestamps: bytes


def read_recording(raw: RawDrive, most: int) -> Recording:
    """Return the oxts of the first `most` frames of a real drive, to be copied unchanged.

    Raises InputError if there are none, DamagedFile if a packet cannot be read.
    """
    frames = list(raw.oxts)[:most]
    if not frames:
        raise InputError(f"{raw.folder / 'oxts' / 'data'} holds no packets, and town.replay drives by them: extract it")
    rows = np.array([read_row(raw.oxts[frame]) for frame in frames])
    time_s = read_times(raw.oxts_times, list(raw.oxts))[: len(frames)]
    timestamps = raw.oxts_times.read_bytes()
    if len(frames) < len(raw.oxts) and len(timestamps.rstrip().split(b"\n")) <= max(raw.oxts):
        raise InputError(
            f"{raw.oxts_times} has one line per packet, of a drive cut out of a longer one, so which lines belong to "
            f"the first {most} packets alone is not known: raise town.frames to {len(raw.oxts)}"
        )
    packets = {frame: raw.oxts[frame].read_bytes() for frame in frames}
    return Recording(rows, time_s, packets, timestamps)


def make_recording(rows: np.ndarray, time_s: np.ndarray, date: str, start_s: float) -> Recording:
    """Return the files that hold `rows` [F,30] of the times `time_s` [F]; the first is `start_s` after midnight.

    Args:
        date: as 2026_01_01.
    """
    packets = {frame: _packet(row) for frame, row in enumerate(rows)}
    stamps = np.datetime64(date.replace("_", "-"), "ns") + np.rint((start_s + time_s) * 1e9).astype("timedelta64[ns]")
    return Recording(rows, time_s, packets, "".join(f"{stamp}\n".replace("T", " ") for stamp in stamps).encode("ascii"))


def _packet(row: np.ndarray) -> bytes:
    words = [f"{value:.13g}" for value in row[:COUNTS]] + [f"{value:.0f}" for value in row[COUNTS:]]
    return (" ".join(words) + "\n").encode("ascii")
