"""Read graph files and labels as batches: spans of consecutive frames with overlapping windows.

A window is `window` consecutive frames. Its target is the steering `horizon` frames after its last frame; that frame
needs a label but no graph. A span is consecutive frames that are read and encoded once for all their windows. Frames
are consecutive by KITTI frame number, never by position: a missing frame ends a stretch.

A batch is a dict of arrays: B frames as in pipeline/graphs/graph_file.py, and for W windows of T frames

- windows int64 [W,T] (rows of the batch's frames), dt_s float32 [W,T] (time since the previous frame), base float32 [W]
  (measured value of the window's last frame that the network's output is added to);
- with motion, motion float32 [B,4] since the previous frame: the measured steering angle, yaw rate,
  speed, and whether they were measured; the first two change sign under mirroring;
- with targets, target float32 [W,R] and valid bool [W,R] of R columns, see labelled_drive.py; 0 if unknown.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.graphs.graph_file import Arrays, Graphs, collate
from pipeline.train.labelled_drive import LabelledDrive, Timeline


@dataclass(frozen=True)
class Span:
    """Rows [start, stop) of timeline number `drive`; its windows end at rows start+window-1 … stop-1.

    Its scenes are those of the frames `shift` rows later; the drive's first frame follows its last one.
    """

    drive: int
    start: int
    stop: int
    shift: int = 0


def random_spans(drives: Sequence[LabelledDrive], window: int, windows: int, rng: np.random.Generator) -> list[Span]:
    """Split all stretches into spans of at most `windows` windows of `window` frames; each window is in one span.

    Spans start at a random phase and are shuffled, so that epochs have different batches. Spans without a valid target
    are left out.
    """
    spans = []
    for number, drive in enumerate(drives):
        for start, stop in drive.stretches:
            last = start + window - 1  # row of the first window's last frame
            phase = int(rng.integers(windows)) or windows  # windows in the first span
            edges = [last, *range(last + phase, stop, windows), stop]
            spans += [
                Span(number, a - window + 1, b, drive.scene_shift(rng))
                for a, b in pairwise(edges)
                if a < b and drive.valid[a:b].any()
            ]
    rng.shuffle(spans)
    return spans


def spans(timelines: Sequence[Timeline], window: int, windows: int) -> list[Span]:
    """Return spans of at most `windows` windows that cover each complete window once, in order."""
    return [
        Span(number, first, min(first + windows + window - 1, stop), timeline.scene_shift())
        for number, timeline in enumerate(timelines)
        for start, stop in timeline.stretches
        for first in range(start, stop - window + 1, windows)
    ]


def read_batch(
    timelines: Sequence[Timeline], files: Mapping[int, Graphs], group: Sequence[Span], window: int
) -> Arrays:
    """Read a group of spans as one batch, with targets if the timelines are drives.

    `files`: number of a timeline → its open graph file.
    """
    columns: dict[str, list[np.ndarray]] = defaultdict(list)
    scenes = []
    before = 0  # frames of the batch before the span
    for span in group:
        timeline, file, length = timelines[span.drive], files[span.drive], span.stop - span.start
        rows, ends = slice(span.start, span.stop), slice(span.start + window - 1, span.stop)
        members = np.arange(length - window + 1)[:, None] + np.arange(window)  # [W,T]
        columns["windows"].append(members + before)
        columns["dt_s"].append(timeline.dt_s[rows][members])
        columns["base"].append(timeline.base[ends].astype(np.float32))
        if timeline.motion is not None:
            columns["motion"].append(timeline.motion[rows])
        if isinstance(timeline, LabelledDrive):
            # Targets without a label have weight 0, but 0 × NaN is NaN.
            columns["target"].append(np.nan_to_num(timeline.target[ends]).astype(np.float32))
            columns["valid"].append(timeline.valid[ends])
        before += length
        frames = len(timeline.frame)
        first = (span.start + span.shift) % frames
        parts = (first, min(first + length, frames)), (0, first + length - frames)  # the second continues at the start
        scenes += [(file, start, stop) for start, stop in parts if start < stop]
    return collate(scenes) | {name: np.concatenate(parts) for name, parts in columns.items()}
