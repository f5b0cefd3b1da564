"""Visual odometry from images and their depth: track corners, lift them to 3D, estimate the
pose.
"""

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import project, transform
from pipeline.camera.lens import depth_limit
from pipeline.motion.pose import MIN_POINTS, estimate_pose
from pipeline.motion.road import Road
from pipeline.motion.step import STANDSTILL, Step
from pipeline.motion.still import Still

MOVING = np.isin(np.arange(256), classes.TRAFFIC)
# px; smaller images are enlarged, since the error of tracking is a fixed fraction of a pixel
MIN_WIDTH = 640
MIN_DEPTH_M = 0.5
# largest ratio of depths around a corner: at depth edges, the depth of a corner is ambiguous
EDGE = 1.3
AROUND = np.ones((5, 5), np.uint8)
# cell px, least quality: a road has few and weak corners
ON_ROAD, ELSEWHERE = (16, 2e-5), (24, 1e-4)
ROAD_SIGMA, DEPTH_SIGMA = 0.07, 0.5  # relative standard deviations of depth
# the car stands if the median corner, or the camera, moves less
STANDSTILL_PX, STANDSTILL_M = 0.1, 0.02
# largest sideways motion: a constant plus a share of the forward motion
SIDEWAYS_M, SIDEWAYS_SHARE = 0.1, 0.5
MAX_FORWARD_M = 10.0
PER_CELL = 2  # corners
# px, pyramid levels; a larger window is slower and covers several depths
WINDOW, LEVELS = (11, 11), 2
CRITERIA = (3, 8, 0.03)  # 8 iterations, or a change below 0.03 px
ROUND_TRIP_PX = 0.5  # largest distance between a corner and its track to the next image and back


class Odometry:
    """Tracks the frames of one drive."""

    def __init__(self, camera: Camera) -> None:
        self._K, width = camera.K, camera.size[1]
        self._max_depth_m = depth_limit(camera)
        self._enlarged = -(-MIN_WIDTH // width)
        self.road = Road(camera)
        self.still = Still(camera)
        # share of the class road where a road is searched, in the last frame; NaN: no classes
        self.road_class = np.nan
        self._number: int | None = None
        self._grey = np.empty(0, np.uint8)
        self._points = np.empty((0, 3)), np.empty(0), 1.0  # of the previous frame: see _lift
        self._T_before_now: np.ndarray | None = None  # the previous step
        self.problem = ""  # why the last step could not be measured; empty if it was

    def step(self, frame: Frame) -> Step | None:
        """Return the motion since the previous frame; None where it cannot be measured. Frames come
        in order.
        """
        grey, factor = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), self._enlarged
        if factor > 1:
            grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        result: Step | str = "no previous frame"
        if self._number is not None and frame.number == self._number + 1:
            every = slice(None, None, factor)
            self.still.add(self._grey[every, every], grey[every, every], self.road.slope)
            result = self._measure(grey)
        step, self.problem = (None, result) if isinstance(result, str) else (result, "")
        self._T_before_now = step.T_before_now if step else None
        if step:
            self.road.add_step(step.T_before_now)
        self._number, self._grey, self._points = frame.number, grey, self._lift(frame, grey)
        return step

    def _measure(self, grey: np.ndarray) -> Step | str:
        """Return the motion since the previous frame, or why it cannot be measured: one of
        PROBLEMS.
        """
        xyz, depth_sigma, scale = self._points
        uv_before = project(xyz, self._K)[0]
        uv_guess, T_previous = uv_before, None
        if self._T_before_now is not None:  # assume constant motion
            T_previous = np.linalg.inv(self._T_before_now)
            uv, z = project(transform(T_previous, xyz), self._K)
            uv_guess = np.where(z[:, None] > MIN_DEPTH_M, uv, uv_before)
        uv, tracked = track(self._grey, grey, self._larger(uv_before), self._larger(uv_guess))
        column, row = np.rint(uv_before).astype(np.int64).T
        tracked &= ~self.still.mask[row, column]
        xyz, uv_before, uv = xyz[tracked], uv_before[tracked], self._smaller(uv[tracked])
        if len(uv) < MIN_POINTS:
            return "too few points can be tracked"
        if np.median(np.abs(uv - uv_before).max(axis=1)) < STANDSTILL_PX:
            return STANDSTILL[0]
        pose = estimate_pose(xyz, uv, self._K, depth_sigma[tracked], T_previous)
        if pose is None:
            return "no common motion of the scene"
        T_before_now = np.linalg.inv(pose.T_now_before)
        right, down, forward = T_before_now[:3, 3]
        if np.linalg.norm(T_before_now[:3, 3]) < STANDSTILL_M:
            return STANDSTILL[1]
        if (
            np.hypot(right, down) >= SIDEWAYS_M + SIDEWAYS_SHARE * abs(forward)
            or abs(forward) >= MAX_FORWARD_M
        ):
            return "a motion that is not a car's"
        return Step(
            T_before_now,
            int(pose.inliers.sum()),
            float(np.median(pose.error_px[pose.inliers])),
            scale,
        )

    def _lift(self, frame: Frame, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the corners as points [N,3] in metres, relative sigma of their depths [N], factor
        applied to depth.
        """
        depth_m = frame.depth_m.astype(np.float32)
        nearest, farthest = cv2.erode(depth_m, AROUND), cv2.dilate(depth_m, AROUND)
        usable = (
            (nearest > MIN_DEPTH_M) & (farthest < self._max_depth_m) & (farthest < EDGE * nearest)
        )
        usable &= ~(still := self.still.mask)
        quality = corner_quality(grey)
        # unlike a black image, of which depth is imagined
        shows_something = bool(quality.max() > ON_ROAD[1])
        usable &= shows_something
        traffic = cv2.dilate(MOVING[frame.cls].astype(np.uint8), AROUND) > 0  # and its surroundings
        # Trust depth over classes: road pixels are never traffic. In grey images, shaded road has
        # the class of cars.
        road, scale = self.road.find(depth_m, usable, still)
        cls = frame.cls[self.road.in_front & shows_something]
        known = cls[cls != classes.VOID]
        self.road_class = float((known == classes.ROAD).mean()) if len(known) else np.nan
        on_road = best_corners(quality * self._enlarge(road), *ON_ROAD)
        elsewhere = best_corners(quality * self._enlarge(usable & ~road & ~traffic), *ELSEWHERE)
        uv = self._smaller(np.concatenate([on_road, elsewhere]))
        column, row = np.rint(uv).astype(np.int64).T
        rays = np.linalg.solve(self._K, np.column_stack([uv, np.ones(len(uv))]).T).T
        depth_sigma = np.where(road[row, column], ROAD_SIGMA, DEPTH_SIGMA)
        return rays * (depth_m[row, column] * scale)[:, None], depth_sigma, scale

    def _enlarge(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask [H,W] at the size of the enlarged images."""
        return mask.repeat(self._enlarged, axis=0).repeat(self._enlarged, axis=1)

    # As in Camera.scaled, the image's edge is fixed, not the centre of its first pixel.
    def _larger(self, uv: np.ndarray) -> np.ndarray:
        return ((uv + 0.5) * self._enlarged - 0.5).astype(np.float32)

    def _smaller(self, uv: np.ndarray) -> np.ndarray:
        return (uv.astype(np.float64) + 0.5) / self._enlarged - 0.5


def corner_quality(grey: np.ndarray) -> np.ndarray:
    """Return the least eigenvalue of an image's structure tensor over 3 x 3 px, [H,W]; 0 but at its
    local maxima.
    """
    quality = cv2.cornerMinEigenVal(grey, blockSize=3)  # of intensities from 0 to 1
    return np.where(quality == cv2.dilate(quality, np.ones((5, 5), np.uint8)), quality, 0)


def best_corners(quality: np.ndarray, cell: int, min_quality: float) -> np.ndarray:
    """Return the PER_CELL best corners above `min_quality` of each square of `cell` px, float32
    [N,2] as (u, v).
    """
    v, u = np.nonzero(quality > min_quality)
    best_first = np.argsort(-quality[v, u], kind="stable")
    v, u = v[best_first], u[best_first]
    cell_index = v // cell * (quality.shape[1] // cell + 1) + u // cell
    by_cell = np.argsort(cell_index, kind="stable")  # within a cell, the best is still first
    _, first, counts = np.unique(cell_index[by_cell], return_index=True, return_counts=True)
    rank = np.arange(len(v)) - np.repeat(first, counts)
    chosen = by_cell[rank < PER_CELL]
    return np.stack([u[chosen], v[chosen]], axis=-1).astype(np.float32)


def track(
    before: np.ndarray, now: np.ndarray, uv: np.ndarray, uv_guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Track corners of image `before` to image `now`, both uint8 [H,W], by pyramidal Lucas-Kanade,
    forth and back.

    Returns positions in `now` and whether they passed the round-trip check, bool [N], for corners
    `uv` and initial positions `uv_guess`, all float32 [N,2].
    """
    if not len(uv):
        return uv, np.zeros(0, bool)
    options = WINDOW, LEVELS, CRITERIA, cv2.OPTFLOW_USE_INITIAL_FLOW
    forth, forth_ok, _ = cv2.calcOpticalFlowPyrLK(
        before, now, uv, uv_guess.copy(), None, None, *options
    )
    back_guess = forth - (uv_guess - uv)
    back, back_ok, _ = cv2.calcOpticalFlowPyrLK(
        now, before, forth, back_guess, None, None, *options
    )
    height, width = now.shape
    inside = (forth >= 0).all(axis=1) & (forth[:, 0] < width) & (forth[:, 1] < height)
    returned = np.linalg.norm(back - uv, axis=1) < ROUND_TRIP_PX
    return forth, (forth_ok[:, 0] > 0) & (back_ok[:, 0] > 0) & returned & inside
