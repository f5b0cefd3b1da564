"""Motion from LiDAR scans: each one laid on the one before, points to planes, from where the last step would lead.

By Open3D, which was the most exact of those compared, small_gicp, KISS-ICP and itself; small_gicp is faster. What moves
by itself fits nowhere, and Tukey's weights leave it out. The second, narrower ones are needed on dense scans: their
rings travel with the car, and hold on to those before where a road has little else.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.motion.step import Step, plausible, standing

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

NEAREST_M, FARTHEST_M = 3.0, 80.0  # nearer is the car itself
VOXEL_M = 0.5
NEIGHBOURS = 10  # of a normal
FIRST_M = (4.0, 1.0)  # how far apart points may lie, and Tukey's k, where no step before gives a guess
PASSES_M = ((1.0, 0.3), (0.5, 0.15))
ITERATIONS = 20
MIN_POINTS = 300
MIN_SHARE = 0.5  # of points that find a plane
MIN_HOLD = 0.01  # mean squared component of the normals along the direction that they hold least: all around, 1/3


class Scan(NamedTuple):
    """A frame: KITTI number, points [P,≥3] in m with the sensor in the origin."""

    number: int
    points: np.ndarray


class Odometry:
    """What is known of a drive so far: the scan before, the step before. It can be pickled, to go on later."""

    def __init__(self, T_cam_velo: np.ndarray) -> None:
        """Begin a drive. `T_cam_velo` [4,4] takes points from a scan to the camera's frame, in which steps are."""
        self._T_cam_velo = T_cam_velo
        self._before: Scan | None = None
        self._cloud: PointCloud | None = None  # of the scan before
        self._guess: np.ndarray | None = None

    def step(self, scan: Scan) -> Step | None:
        """Return the motion since the frame before; None where it is not measured. Scans come in order of numbers."""
        number, before, guess = self._before.number if self._before else None, self._cloud, self._guess
        now, T_before, step = _cloud(scan.points), None, None
        self._before, self._cloud, self._guess = scan, now, None
        if before is not None and now is not None and number is not None and scan.number == number + 1:
            T_before, inliers, residual_m = _aligned(now, before, guess)
        T_cam_velo = self._T_cam_velo
        if T_before is not None and plausible(T_cam_before := T_cam_velo @ T_before @ np.linalg.inv(T_cam_velo)):
            self._guess = T_before  # a step that no car makes would mislead the next one
            step = None if standing(T_before) else Step(T_cam_before, inliers, residual_m)
        return step

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_cloud": None}  # Open3D's cannot be pickled

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._cloud = _cloud(self._before.points) if self._before else None


@contextmanager
def _one_thread() -> Iterator[None]:
    """Have Open3D sum up in one order: on several threads the last bits of a pose change from run to run."""
    import open3d as o3d

    before = o3d.utility.get_max_threads()
    o3d.utility.set_max_threads(1)
    try:
        yield
    finally:
        o3d.utility.set_max_threads(before)


@_one_thread()
def _cloud(points: np.ndarray) -> "PointCloud | None":
    """Return the scan thinned out, with normals; None if too little is left."""
    import open3d as o3d

    xyz = points[:, :3].astype(np.float64)
    distance_m = np.linalg.norm(xyz, axis=1)
    xyz = xyz[(distance_m > NEAREST_M) & (distance_m < FARTHEST_M)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz)).voxel_down_sample(VOXEL_M)
    if len(cloud.points) < MIN_POINTS:
        return None
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    return cloud


@_one_thread()
def _aligned(now: "PointCloud", before: "PointCloud", guess: np.ndarray | None) -> tuple[np.ndarray | None, int, float]:
    """Return T_before [4,4] of the sensor, None where the scans do not tell; inliers, their RMS distance in m."""
    from open3d.pipelines import registration as icp

    T_before, until = np.eye(4) if guess is None else guess, icp.ICPConvergenceCriteria(1e-5, 1e-5, ITERATIONS)
    for reach_m, k_m in PASSES_M if guess is not None else (FIRST_M, *PASSES_M):
        planes = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(k_m))
        result = icp.registration_icp(now, before, reach_m, T_before, planes, until)
        T_before = result.transformation
    pairs = np.asarray(result.correspondence_set)
    if result.fitness < MIN_SHARE:
        return None, 0, 0.0
    normals = np.asarray(before.normals)[pairs[:, 1]]
    if np.linalg.eigvalsh(np.einsum("pi,pj->ij", normals, normals) / len(normals))[0] < MIN_HOLD:
        return None, 0, 0.0
    return T_before, len(pairs), float(result.inlier_rmse)
