"""Draw the contact sheet: frames of the sample beside their depth and classes."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.camera.images import to_metres
from pipeline.camera.pixels import read_pixels

View = tuple[np.ndarray, np.ndarray, np.ndarray]
"""RGB uint8 [H,W,3], depth in metres [H,W] (0: none), class numbers uint8 [H,W]."""
WHITE_M = 4.0  # nearer is white; brightness falls with 1 / depth


def contact_sheet(views: Sequence[View], width: int = 360, gap: int = 4) -> np.ndarray:
    """Return an RGB uint8 picture with a row per view: image, depth and classes, each `width` pixels wide."""
    rows = []
    for rgb, depth_m, cls in views:
        height = round(width * rgb.shape[0] / rgb.shape[1])
        tiles = []
        for picture, how in (
            (rgb, cv2.INTER_AREA),
            (_shade(depth_m), cv2.INTER_NEAREST_EXACT),
            (classes.colourise(cls), cv2.INTER_NEAREST_EXACT),
        ):
            tile = cv2.resize(picture, (width, height), interpolation=how)
            tiles.append(np.pad(tile, ((0, gap), (0, gap), (0, 0)), constant_values=255))
        rows.append(np.concatenate(tiles, axis=1))
    return np.concatenate(rows)[:-gap, :-gap]


def _shade(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres [H,W] as grey uint8 [H,W,3], brighter where nearer, black where there is none."""
    nearness = WHITE_M / np.where(depth_m > 0, depth_m, np.inf)
    return np.repeat((255 * nearness.clip(max=1)).astype(np.uint8)[..., None], 3, axis=-1)


def read_views(folders: list[Path], count: int) -> list[View]:
    """Return `count` frames of rendered drives, spread over drives and their frames."""
    views = []
    for i in range(count):
        folder = folders[i * len(folders) // count]
        frames = sorted((folder / "truth" / "cls").iterdir())
        name = frames[(2 * i + 1) * len(frames) // (2 * count)].name
        rgb, depth, cls = (read_pixels(folder / kind / name) for kind in ("image_02/data", "truth/depth", "truth/cls"))
        views.append((rgb, to_metres(depth), cls))
    return views
