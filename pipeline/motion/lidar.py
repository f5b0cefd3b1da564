"""LiDAR odometry: register each scan to the previous one, point to plane, starting from the last step.

Open3D was the most accurate in a comparison with small_gicp, which is faster, and KISS-ICP. Tukey's weights suppress
moving objects as outliers. Dense scans need the second, narrower pass: their rings move with the car and pull the
registration towards zero motion where a road has little structure.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from pipeline.camera.camera import Frame
from pipeline.motion.step import Step, is_standstill, plausible

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

MIN_RANGE_M, MAX_RANGE_M = 3.0, 80.0  # nearer points belong to the car itself
VOXEL_M = 0.5
NORMAL_NEIGHBOURS = 10
FIRST_PASS_M = (4.0, 1.0)  # largest distance of a pair, Tukey's k; without an initial guess
PASSES_M = ((1.0, 0.3), (0.5, 0.15))
ITERATIONS = 20
MIN_POINTS = 300
MIN_FITNESS = 0.5  # share of points with a pair
MIN_CONSTRAINT = 0.01  # least mean squared component of the normals along any direction; isotropic normals: 1/3


class Odometry:
    """Registers the scans of one drive."""

    def __init__(self, T_cam_velo: np.ndarray) -> None:
        """`T_cam_velo` [4,4] transforms points from the scan to the camera frame, in which steps are expressed."""
        self._T_cam_velo = T_cam_velo
        self._number: int | None = None  # of the previous scan
        self._cloud: PointCloud | None = None  # of the previous scan
        self._guess: np.ndarray | None = None

    def step(self, frame: Frame) -> Step | None:
        """Return the motion since the previous frame; None where it cannot be measured. Frames come in order."""
        assert frame.scan is not None
        number, before, guess = self._number, self._cloud, self._guess
        now, T_before, step = _preprocess(frame.scan), None, None
        self._number, self._cloud, self._guess = frame.number, now, None
        if before is not None and now is not None and number is not None and frame.number == number + 1:
            T_before, inliers, residual_m = _register(now, before, guess)
        T_cam_velo = self._T_cam_velo
        if T_before is not None and plausible(T_cam_before := T_cam_velo @ T_before @ np.linalg.inv(T_cam_velo)):
            self._guess = T_before
            step = None if is_standstill(T_before) else Step(T_cam_before, inliers, residual_m)
        return step


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit Open3D to one thread: with several, the last bits of a pose change from run to run."""
    import open3d as o3d

    before = o3d.utility.get_max_threads()
    o3d.utility.set_max_threads(1)
    try:
        yield
    finally:
        o3d.utility.set_max_threads(before)


@_one_thread()
def _preprocess(points: np.ndarray) -> "PointCloud | None":
    """Return the downsampled scan with normals; None if fewer than MIN_POINTS remain."""
    import open3d as o3d

    xyz = points[:, :3].astype(np.float64)
    range_m = np.linalg.norm(xyz, axis=1)
    xyz = xyz[(range_m > MIN_RANGE_M) & (range_m < MAX_RANGE_M)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz)).voxel_down_sample(VOXEL_M)
    if len(cloud.points) < MIN_POINTS:
        return None
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS))
    return cloud


@_one_thread()
def _register(
    now: "PointCloud", before: "PointCloud", guess: np.ndarray | None
) -> tuple[np.ndarray | None, int, float]:
    """Return T_before [4,4] of the sensor, None if the scans do not constrain it; inliers; their RMS distance in m."""
    from open3d.pipelines import registration as icp

    T_before, criteria = np.eye(4) if guess is None else guess, icp.ICPConvergenceCriteria(1e-5, 1e-5, ITERATIONS)
    for distance_m, k_m in PASSES_M if guess is not None else (FIRST_PASS_M, *PASSES_M):
        to_plane = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(k_m))
        result = icp.registration_icp(now, before, distance_m, T_before, to_plane, criteria)
        T_before = result.transformation
    pairs = np.asarray(result.correspondence_set)
    if result.fitness < MIN_FITNESS:
        return None, 0, 0.0
    normals = np.asarray(before.normals)[pairs[:, 1]]
    if np.linalg.eigvalsh(np.einsum("pi,pj->ij", normals, normals) / len(normals))[0] < MIN_CONSTRAINT:
        return None, 0, 0.0
    return T_before, len(pairs), float(result.inlier_rmse)
