"""How long stages take and what they write, as measured: the one place of these figures. All of it is an estimate.

Seconds are of one core: of a 2-core virtual machine, user time of single stages on the sample less their start, on
which other work had no say; at KITTI's sizes of docs/scale.md (backbones, graphs, training) and of the real drives of
presets/real.yaml. Bytes are those of data/README.md, "Size arithmetic". Good to a factor of two.
"""

from collections.abc import Mapping
from typing import NamedTuple


class Size(NamedTuple):
    """What a run is made of: frames of the sample, of KITTI, and of train drives; pixels of an image as ingested."""

    town_frames: int
    kitti_frames: int
    train_frames: int
    pixels: int
    town_scan_points: int  # of a scan; 0: none are read
    kitti_scan_points: int

    @property
    def frames(self) -> int:
        return self.town_frames + self.kitti_frames


class Network(NamedTuple):
    """What a model of params.yaml costs: its frames are of so many points or, without, of images."""

    points: int | None
    spatial: str
    epochs: int
    networks: int  # seeds and folds
    window: int
    run_windows: int
    equivariant: bool


START_S = 3.0  # of each stage: imports
PER_CLOUD_POINT_B, PER_GRAPH_POINT_B = 5.3, 13.5
_IMAGE_B, _SCAN_POINT_B, _PERCEIVED_B = 2.4, 11.8, 1.46  # per pixel, point, pixel
_TOWN_FRAME_B = 500_000  # PNG, scan and truth at 188 x 621 pixels
# Of an image beside `small`, docs/scale.md; a network that is not listed is taken for one of the size of espnetv2.
_BACKBONES = {
    "precomputed": 0.2,
    "small": 1.0,
    "espnetv2-s1": 2.4,
    "espnetv2": 2.9,
    "swin-t": 8.4,
    "dinov2-vits14": 10.3,
}
_FORWARD_S = 0.4e-6  # per pixel of `small`; fitting costs three times that
_TRAIN_S = {"gnn": (1.2e-3, 0.9e-6), "pointnet2": (1.2e-3, 3.3e-6), "cnn": (1.2e-3, 0.19e-6)}  # per frame, per point


def bytes_of_raw_stages(size: Size) -> dict[str, float]:
    """Return stage → bytes of the stages whose files depend on images and scans alone."""
    points = size.town_frames * size.town_scan_points + size.kitti_frames * size.kitti_scan_points
    return {
        "town": size.town_frames * _TOWN_FRAME_B,
        "ingest": size.frames * size.pixels * _IMAGE_B + points * _SCAN_POINT_B,
        "perception": size.frames * size.pixels * _PERCEIVED_B,
    }


def bytes_of_images(size: Size) -> float:
    """Return the bytes of a graph variant that holds the images themselves."""
    return size.frames * size.pixels * _IMAGE_B


def seconds_of_raw_stages(size: Size, encoder: tuple[str, int], kinds: Mapping[str, bool]) -> dict[str, float]:
    """Return stage → seconds of one core, START_S not counted.

    Args:
        encoder: its backbone, and how many frames it is fitted to in all epochs.
        kinds: of measured motion, which are made.
    """
    backbone, fitted = encoder
    forward = size.pixels * _FORWARD_S * _BACKBONES.get(backbone, _BACKBONES["espnetv2"])
    motion = (0.007 + size.pixels * 0.075e-6) * kinds.get("visual", False) + 0.02 * kinds.get("lidar", False)
    return {
        "town": size.town_frames * 0.062,
        "ingest": size.frames * 0.010,
        "labels": size.frames * 1e-4,
        "encoder": fitted * 3 * forward,
        "perception": size.frames * forward,
        "motion": size.frames * motion,
        "scores": size.town_frames * size.pixels * 0.3e-6,
    }


def seconds_of_clouds(size: Size, points: int, kinds: int) -> float:
    return size.frames * kinds * points * 0.33e-6


def seconds_of_graphs(size: Size, points: int | None) -> float:
    """Return seconds of one core of a graph variant; of points None: of images."""
    return size.frames * (0.0013 + 1e-6 * points if points else 0.001)


def seconds_of_training(size: Size, network: Network) -> float:
    """Return seconds of one core; windows share their frames, and both halves of an equivariant network count."""
    per_frame, per_part = _TRAIN_S.get(network.spatial, _TRAIN_S["gnn"])
    shared = (network.run_windows + network.window - 1) / network.run_windows
    step = (per_frame + per_part * (network.points or size.pixels)) * (2 if network.equivariant else 1)
    return size.train_frames * shared * network.epochs * network.networks * step
