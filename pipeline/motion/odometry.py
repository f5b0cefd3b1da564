"""Visual odometry: track corners, lift them to 3D by the images' depth, and estimate the pose."""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import project, transform
from pipeline.camera.pinhole import depth_limit
from pipeline.motion.pose import MIN_POINTS, Matches, estimate_pose
from pipeline.motion.road import Road
from pipeline.motion.step import Step
from pipeline.motion.still import Still
from pipeline.motion.triangulation import Ratio, Tracks, compare_lengths, find_tracks, pixel_rays

# Whether a class, the index, is one of traffic.
IS_TRAFFIC = np.isin(np.arange(256), classes.TRAFFIC)
# Least width in pixels of the images that are tracked. Smaller ones are enlarged, since the error
# of tracking is a fixed fraction of a pixel.
MIN_WIDTH = 640
# Least depth in metres that is used.
MIN_DEPTH_M = 0.5
# Largest ratio of depths around a corner: at depth edges, the depth of a corner is ambiguous.
EDGE = 1.3
# Size in pixels of the area around a corner in which depths are compared.
AROUND = np.ones((5, 5), np.uint8)
# Relative standard deviation of depth on the road.
ROAD_SIGMA = 0.07
# Relative standard deviation of depth elsewhere.
DEPTH_SIGMA = 0.5

# Width in pixels of the cells that give PER_CELL corners each.
CELL_PX = 24
# Least quality of a corner, see :func:`measure_quality`.
MIN_QUALITY = 1e-4
# Width in pixels of the cells on the road, which has few corners.
ROAD_CELL_PX = 16
# Least quality of a corner on the road, whose corners are weak.
MIN_ROAD_QUALITY = 2e-5
PER_CELL = 2

# Size in pixels of the window of Lucas and Kanade. A larger one is slower and covers several
# depths.
WINDOW = (11, 11)
# Number of halvings of the images.
LEVELS = 2
# The iteration of Lucas and Kanade ends after 8 steps, or with a step of less than 0.03 px.
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 8, 0.03)
# Largest distance in pixels between a corner and its track to the next image and back.
ROUND_TRIP_PX = 0.5

# Motion in pixels of the median corner below which the car stands.
STANDSTILL_PX = 0.1
# Motion in metres of the camera below which the car stands.
STANDSTILL_M = 0.02
# Largest sideways motion in metres of a car that does not move forward.
SIDEWAYS_M = 0.1
# What a car may move sideways beyond SIDEWAYS_M, as a share of its motion forward.
SIDEWAYS_SHARE = 0.5
# Largest motion forward in metres.
MAX_FORWARD_M = 10.0


class _LiftedFrame(NamedTuple):
    """A grey image, and its N corners as points."""

    number: int
    grey: np.ndarray  # uint8 [H,W], enlarged if it is small
    xyz: np.ndarray  # [N,3] in metres
    depth_sigma: np.ndarray  # relative standard deviations of the depths [N]


class Odometry:
    """Tracks the frames of one drive."""

    def __init__(self, camera: Camera) -> None:
        width = camera.size[1]
        self._K = camera.K
        self._max_depth_m = depth_limit(camera)
        self._enlarged = -(-MIN_WIDTH // width)
        self.road = Road(camera)
        self.still = Still(camera)
        # Why the last step could not be measured; empty if it was.
        self.problem = ""
        self._previous: _LiftedFrame | None = None
        # The step to the previous frame, and its points as they are seen there.
        self._T_before_now: np.ndarray | None = None
        self._tracks: Tracks | None = None

    def measure_step(self, frame: Frame) -> Step | None:
        """Return the motion since the previous frame; None where it cannot be measured.

        Frames come in order.
        """
        grey = self._to_grey(frame.image)
        result: Step | str = "no previous frame"
        previous = self._previous
        if previous is not None and frame.number == previous.number + 1:
            every = slice(None, None, self._enlarged)
            self.still.add_images(previous.grey[every, every], grey[every, every], self.road.slope)
            result = self._measure_since(previous, grey)

        if isinstance(result, str):
            step = None
            self.problem = result
            self._T_before_now = None
            self._tracks = None
        else:
            step = result
            self.problem = ""
            self._T_before_now = step.T_before_now
            self.road.add_step(step.T_before_now)

        self._previous = self._lift_corners(frame, grey)
        return step

    def _measure_since(self, previous: _LiftedFrame, grey: np.ndarray) -> Step | str:
        """Return the motion since the previous frame, or why it cannot be measured (PROBLEMS)."""
        uv_before = project(previous.xyz, self._K)[0]

        # Follow the corners of the previous frame into this one, as if the car moved on as before.
        T_previous = None
        if self._T_before_now is not None:
            T_previous = np.linalg.inv(self._T_before_now)
        uv, tracked = self._follow_points(previous.grey, grey, uv_before, previous.xyz, T_previous)
        column, row = np.rint(uv_before).astype(np.int64).T
        tracked &= ~self.still.mask[row, column]
        uv_before = uv_before[tracked]
        uv = uv[tracked]
        matches = Matches(previous.xyz[tracked], previous.depth_sigma[tracked], uv)
        if len(uv) < MIN_POINTS:
            return "too few points can be tracked"
        if np.median(np.abs(uv - uv_before).max(axis=1)) < STANDSTILL_PX:
            return "the image does not move"

        # Rotation and direction come from the pixels, the length of the step from depth.
        pose = estimate_pose(matches, self._K, T_previous)
        if pose is None:
            return "no common motion of the scene"
        T_before_now = np.linalg.inv(pose.T_now_before)
        if np.linalg.norm(T_before_now[:3, 3]) < STANDSTILL_M:
            return "the camera stands"
        if not _is_possible_for_a_car(T_before_now):
            return "a motion that is not a car's"
        ratio = self._compare_lengths(previous, grey, T_before_now)
        self._tracks = find_tracks(uv_before[pose.inliers], uv[pose.inliers], T_before_now, self._K)
        return Step(T_before_now, *ratio)

    def _compare_lengths(
        self, previous: _LiftedFrame, grey: np.ndarray, T_before_now: np.ndarray
    ) -> Ratio:
        """Return the length of a step relative to that of the step before, if it was measured."""
        tracks = self._tracks
        if tracks is None or not len(tracks.uv) or self._T_before_now is None:
            return Ratio()

        # Follow the points of the step before once more.
        length_m = np.linalg.norm(self._T_before_now[:3, 3])
        xyz = pixel_rays(tracks.uv, self._K) * (tracks.depth_steps * length_m)[:, None]
        T_now_before = np.linalg.inv(T_before_now)
        uv, tracked = self._follow_points(previous.grey, grey, tracks.uv, xyz, T_now_before)
        seen = Tracks(*(column[tracked] for column in tracks))
        return compare_lengths(seen, uv[tracked], T_before_now, self._K)

    def _follow_points(
        self,
        grey_before: np.ndarray,
        grey: np.ndarray,
        uv_before: np.ndarray,
        xyz_before: np.ndarray,
        T_now_before: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return where pixels [N,2] are after a step, and whether they are tracked, bool [N].

        They are searched where their points [N,3] are after the expected motion, if it is known.
        """
        uv_guess = uv_before
        if T_now_before is not None:
            uv_ahead, z = project(transform(T_now_before, xyz_before), self._K)
            uv_guess = np.where(z[:, None] > MIN_DEPTH_M, uv_ahead, uv_before)
        uv, tracked = track_corners(
            grey_before, grey, self._to_enlarged(uv_before), self._to_enlarged(uv_guess)
        )
        return self._from_enlarged(uv), tracked

    def _lift_corners(self, frame: Frame, grey: np.ndarray) -> _LiftedFrame:
        """Return a frame and its corners as points, their depth scaled to the camera's height."""
        depth_m = frame.depth_m.astype(np.float32)
        quality = measure_quality(grey)
        # A black image shows nothing, so its depth is imagined.
        shows_something = quality.max() > MIN_ROAD_QUALITY
        usable = self._has_depth(depth_m) & ~self.still.mask & shows_something

        # Trust depth over classes: road pixels are never traffic. In grey images, shaded road has
        # the class of cars.
        road, scale = self.road.find_road(depth_m, usable, self.still.mask)
        traffic = cv2.dilate(IS_TRAFFIC[frame.cls].astype(np.uint8), AROUND) > 0
        elsewhere = usable & ~road & ~traffic

        # Few corners of a road are good, but their depths are the best.
        on_road = pick_corners(quality * self._enlarge_mask(road), ROAD_CELL_PX, MIN_ROAD_QUALITY)
        beside = pick_corners(quality * self._enlarge_mask(elsewhere), CELL_PX, MIN_QUALITY)
        uv = self._from_enlarged(np.concatenate([on_road, beside]))

        # Back-project the corners by their depth.
        column, row = np.rint(uv).astype(np.int64).T
        xyz = pixel_rays(uv, self._K) * (depth_m[row, column] * scale)[:, None]
        depth_sigma = np.where(road[row, column], ROAD_SIGMA, DEPTH_SIGMA)
        return _LiftedFrame(frame.number, grey, xyz, depth_sigma)

    def _has_depth(self, depth_m: np.ndarray) -> np.ndarray:
        """Return a mask of pixels with a depth in range that is that of their neighbours, too."""
        nearest_m = cv2.erode(depth_m, AROUND)
        farthest_m = cv2.dilate(depth_m, AROUND)
        in_range = (nearest_m > MIN_DEPTH_M) & (farthest_m < self._max_depth_m)
        return in_range & (farthest_m < EDGE * nearest_m)

    def _to_grey(self, image: np.ndarray) -> np.ndarray:
        """Return a grey image, enlarged if it is small."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        factor = self._enlarged
        if factor > 1:
            grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        return grey

    def _enlarge_mask(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask [H,W] at the size of the enlarged images."""
        return mask.repeat(self._enlarged, axis=0).repeat(self._enlarged, axis=1)

    # As in Camera.scaled, the image's edge is fixed, not the centre of its first pixel.
    def _to_enlarged(self, uv: np.ndarray) -> np.ndarray:
        """Return pixels [N,2] of an image as pixels of its enlarged image, float32."""
        return ((uv + 0.5) * self._enlarged - 0.5).astype(np.float32)

    def _from_enlarged(self, uv: np.ndarray) -> np.ndarray:
        """Return pixels [N,2] of an enlarged image as pixels of the image itself."""
        return (uv.astype(np.float64) + 0.5) / self._enlarged - 0.5


def _is_possible_for_a_car(T_before_now: np.ndarray) -> bool:
    """Return whether a car can make the step [4,4]: not too far, and hardly sideways."""
    right, down, forward = T_before_now[:3, 3]
    max_sideways_m = SIDEWAYS_M + SIDEWAYS_SHARE * abs(forward)
    return np.hypot(right, down) < max_sideways_m and abs(forward) < MAX_FORWARD_M


def measure_quality(grey: np.ndarray) -> np.ndarray:
    """Return the quality of a corner at each pixel [H,W]; 0 but at its local maxima.

    It is the least eigenvalue of the structure tensor over 3 x 3 px, of intensities from 0 to 1.
    """
    quality = cv2.cornerMinEigenVal(grey, blockSize=3)
    return np.where(quality == cv2.dilate(quality, np.ones((5, 5), np.uint8)), quality, 0)


def pick_corners(quality: np.ndarray, cell_px: int, min_quality: float) -> np.ndarray:
    """Return the PER_CELL best corners of each cell, float32 [N,2] as (u, v).

    Cells are squares of `cell_px`. The `quality` [H,W] of corners is above `min_quality`.
    """
    v, u = np.nonzero(quality > min_quality)
    best_first = np.argsort(-quality[v, u], kind="stable")
    v = v[best_first]
    u = u[best_first]

    # Sort by cell; within a cell, the best is still first.
    cell_index = v // cell_px * (quality.shape[1] // cell_px + 1) + u // cell_px
    by_cell = np.argsort(cell_index, kind="stable")

    _, first, counts = np.unique(cell_index[by_cell], return_index=True, return_counts=True)
    rank = np.arange(len(v)) - np.repeat(first, counts)
    chosen = by_cell[rank < PER_CELL]
    return np.stack([u[chosen], v[chosen]], axis=-1).astype(np.float32)


def track_corners(
    before: np.ndarray, now: np.ndarray, uv: np.ndarray, uv_guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Track corners of image `before` to image `now`, both uint8 [H,W], and back.

    The method is that of Lucas and Kanade on image pyramids. Returns positions in `now` and whether
    they passed the round-trip check, bool [N], for corners `uv` and initial positions `uv_guess`,
    all float32 [N,2].
    """
    if not len(uv):
        return uv, np.zeros(0, bool)
    forth, forth_ok = _track_once(before, now, uv, uv_guess.copy())
    back, back_ok = _track_once(now, before, forth, forth - (uv_guess - uv))

    height, width = now.shape
    inside = (forth >= 0).all(axis=1) & (forth[:, 0] < width) & (forth[:, 1] < height)
    returned = np.linalg.norm(back - uv, axis=1) < ROUND_TRIP_PX
    return forth, forth_ok & back_ok & returned & inside


def _track_once(
    before: np.ndarray, now: np.ndarray, uv: np.ndarray, uv_guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions [N,2] in `now` of corners `uv` [N,2], and whether they are found [N]."""
    use_guess = cv2.OPTFLOW_USE_INITIAL_FLOW
    uv_now, is_found, _ = cv2.calcOpticalFlowPyrLK(
        before, now, uv, uv_guess, None, None, WINDOW, LEVELS, CRITERIA, use_guess
    )
    return uv_now, is_found[:, 0] > 0
