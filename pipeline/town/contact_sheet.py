"""The contact sheet: a few frames of the sample beside their depth and classes, for people."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.camera import classes

View = tuple[np.ndarray, np.ndarray, np.ndarray]
"""RGB uint8 [H,W,3], depth in metres [H,W] (0: none), class numbers uint8 [H,W]."""
WHITE_M = 4.0  # nearer than this all is white; ten times as far, a tenth as bright


def contact_sheet(views: Sequence[View], width: int = 360, gap: int = 4) -> np.ndarray:
    """Return one picture, uint8 RGB: a row per view; picture, depth, classes side by side, each `width` pixels wide.

    Raises ValueError if there is no view.
    """
    import cv2

    if not views:
        raise ValueError("a contact sheet needs at least one view")
    rows = []
    for rgb, depth_m, cls in views:
        height = round(width * rgb.shape[0] / rgb.shape[1])
        tiles = []
        for picture, how in (
            (rgb, cv2.INTER_AREA),
            (shaded_depth(depth_m), cv2.INTER_NEAREST_EXACT),
            (classes.colourise(cls), cv2.INTER_NEAREST_EXACT),
        ):
            tile = cv2.resize(picture, (width, height), interpolation=how)
            tiles.append(np.pad(tile, ((0, gap), (0, gap), (0, 0)), constant_values=255))
        rows.append(np.concatenate(tiles, axis=1))
    return np.concatenate(rows)[:-gap, :-gap]


def shaded_depth(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres [H,W] as grey uint8 [H,W,3], the brighter the nearer; where there is none (0), black."""
    nearness = WHITE_M / np.where(depth_m > 0, depth_m, np.inf)
    return np.repeat((255 * nearness.clip(max=1)).astype(np.uint8)[..., None], 3, axis=-1)


def write_rgb(path: Path, picture: np.ndarray) -> None:
    """Write a uint8 RGB picture as PNG. Raises OSError."""
    import cv2

    content = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    with replacing(path) as tmp:
        tmp.write_bytes(content.tobytes())
