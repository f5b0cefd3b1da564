"""Check the intrinsics of a pinhole camera, and find the depth up to which it is usable."""

import numpy as np

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.camera.images import Size

# Largest plausible focal length in image widths.
_FOCAL_PER_WIDTH = 100.0
# Largest plausible offset of a principal point from the middle of the image, as a share of the
# image's width or height.
_OFF_CENTRE = 0.2
# Largest plausible offset if the principal point is off to the right and down, or to the left and
# up. Intrinsics for images of another size have such an offset. Udacity's camera has −0.08 and
# 0.13, which have different signs.
_OFF_BOTH = 0.1
# Largest usable depth in metres of a lens with a focal length of up to WIDE.
MAX_DEPTH_M = 80.0
# Focal length in image widths above which the largest usable depth is larger than MAX_DEPTH_M.
WIDE = 0.65


def check_pinhole(K: np.ndarray, size: Size, where: str) -> None:
    """Raise InputError if K [3,3] is implausible for images of `size` (H, W).

    The focal lengths, the principal point and the skew are checked. `where` names K in the message.
    """
    height, width = size
    fx, _, cx = K[0]
    _, fy, cy = K[1]
    no_skew = np.allclose(K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], atol=1e-3)
    focal = min(fx, fy) > 1 and max(fx, fy) < _FOCAL_PER_WIDTH * width  # false for NaN

    # K of images of another size has a principal point that is off to the same side in both
    # directions.
    offset = np.array([cx / width, cy / height]) - 0.5
    same_side = (offset > _OFF_BOTH).all() or (offset < -_OFF_BOTH).all()
    centred = np.abs(offset).max() <= _OFF_CENTRE and not same_side

    if not (focal and centred and no_skew):
        intrinsics = f"focal lengths {fx:g}, {fy:g} and centre {cx:g}, {cy:g}"
        problem = f"implausible intrinsics of {width} x {height} pixels: {intrinsics}"
        if not centred:
            problem += ". K is for another image size?"
        raise InputError(problem, where)


def depth_limit(camera: Camera) -> float:
    """Return the largest usable depth in metres, which is larger for long focal lengths."""
    return MAX_DEPTH_M * max(1.0, camera.K[0, 0] / (WIDE * camera.size[1]))
