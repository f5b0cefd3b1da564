"""Motion from images and their depth: corners, followed, lifted, and the pose that explains where they went."""

from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import project, transform
from pipeline.motion.pose import pose
from pipeline.motion.road import Road
from pipeline.motion.step import Step, plausible, standing
from pipeline.motion.tracks import Corners, follow

MOVING = np.isin(np.arange(256), classes.TRAFFIC)
MIN_WIDTH = 640  # px; smaller images are enlarged: corners are found to a fraction of a pixel, so larger ones say more
NEAREST_M, FARTHEST_M = 0.5, 80.0
EDGE = 1.3  # depths around a corner differ by this factor at most: on an edge, it is not known whose depth it has
AROUND = np.ones((5, 5), np.uint8)
ON_ROAD, ELSEWHERE = (16, 2e-5), (24, 1e-4)  # cells and least quality of corners: a road has few, and needs them
ROAD_SIGMA, DEPTH_SIGMA = 0.07, 0.5  # of depth, as a share of it
STANDING_PX = 0.1  # half of the corners move less: the car stands


class View(NamedTuple):
    """A frame: KITTI number, image RGB uint8 [H,W,3], depth float32 [H,W] in m with 0 = none, trainIds [H,W]."""

    number: int
    image: np.ndarray
    depth_m: np.ndarray
    cls: np.ndarray


class Odometry:
    """What is known of a drive so far: the frame and the step before, the road. It can be pickled, to go on later."""

    def __init__(self, K: np.ndarray, size: tuple[int, ...], camera_height_m: float | None) -> None:
        """Begin a drive.

        Args:
            K: intrinsics [3,3] at the images' size.
            size: (H, W) of the images.
            camera_height_m: over the road, which corrects depth's scale; None: depth is right as it is.
        """
        self._K = K
        self._enlarged = -(-MIN_WIDTH // size[1])
        self._road = Road(K, (size[0], size[1]), camera_height_m)
        self._number: int | None = None
        self._grey = np.empty(0, np.uint8)
        self._points = np.empty((0, 3)), np.empty(0), 1.0
        self._T_before: np.ndarray | None = None

    def step(self, view: View) -> Step | None:
        """Return the motion since the frame before; None where it is not measured. Views come in order of numbers."""
        grey, step = self._read(view.image), None
        if self._number is not None and view.number == self._number + 1:
            step = self._measured(grey)
        self._T_before = step.T_before if step else None
        if step:
            self._road.travelled(step.T_before)
        self._number, self._grey, self._points = view.number, grey, self._lifted(view, grey)
        return step

    def _measured(self, grey: np.ndarray) -> Step | None:
        xyz, depth_sigma, scale = self._points
        uv_before = project(xyz, self._K)[0]
        uv_guess = uv_before
        if self._T_before is not None:  # the car goes on as it did
            uv, z = project(transform(np.linalg.inv(self._T_before), xyz), self._K)
            uv_guess = np.where(z[:, None] > NEAREST_M, uv, uv_before)
        uv, believed = follow(self._grey, grey, self._larger(uv_before), self._larger(uv_guess))
        xyz, uv_before, uv = xyz[believed], uv_before[believed], self._smaller(uv[believed])
        if not len(uv) or np.median(np.abs(uv - uv_before).max(axis=1)) < STANDING_PX:
            return None
        measured = pose(xyz, uv, self._K, depth_sigma[believed])
        if measured is None:
            return None
        T_before = np.linalg.inv(measured.T_now_before)
        if standing(T_before) or not plausible(T_before):
            return None
        return Step(T_before, int(measured.inliers.sum()), measured.residual_px, scale)

    def _lifted(self, view: View, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return a frame's corners as points [N,3] in m, sigma of their depths [N], what depth was multiplied by."""
        usable = _usable(view)
        road, scale = self._road.find(view.depth_m, usable)
        corners = Corners(grey)
        parts = [corners.best(self._whole(part), *how) for part, how in ((road, ON_ROAD), (usable & ~road, ELSEWHERE))]
        uv = self._smaller(np.concatenate(parts))
        column, row = np.rint(uv).astype(np.int64).T
        rays = np.linalg.solve(self._K, np.column_stack([uv, np.ones(len(uv))]).T).T
        depth_sigma = np.where(road[row, column], ROAD_SIGMA, DEPTH_SIGMA)
        return rays * (view.depth_m[row, column] * scale)[:, None], depth_sigma, scale

    def _read(self, image: np.ndarray) -> np.ndarray:
        """Return an image as uint8 [H,W], enlarged to at least MIN_WIDTH."""
        import cv2

        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        factor = self._enlarged
        return cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else grey

    def _whole(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask [H,W] at the size of the enlarged images."""
        return mask.repeat(self._enlarged, axis=0).repeat(self._enlarged, axis=1)

    # As in geometry.scale_K, the edge of an image, not its first pixel's centre, stays where it is.
    def _larger(self, uv: np.ndarray) -> np.ndarray:
        return ((uv + 0.5) * self._enlarged - 0.5).astype(np.float32)

    def _smaller(self, uv: np.ndarray) -> np.ndarray:
        return (uv.astype(np.float64) + 0.5) / self._enlarged - 0.5


def _usable(view: View) -> np.ndarray:
    """Return where depth is known, and a corner may belong to the street, bool [H,W]."""
    import cv2

    nearest, farthest = cv2.erode(view.depth_m, AROUND), cv2.dilate(view.depth_m, AROUND)
    moving = cv2.dilate(MOVING[view.cls].astype(np.uint8), AROUND)
    return (nearest > NEAREST_M) & (farthest < FARTHEST_M) & (farthest < EDGE * nearest) & (moving == 0)
