"""Scores of predicted depth and classes against a truth."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.camera import classes
from pipeline.encoder.truth import Truth
from pipeline.perception.depth_scale import Scale
from pipeline.perception.ground_plane import ground_plane_depth

MIN_DEPTH_M, MAX_DEPTH_M = 1.0, 80.0
DEPTH_ERRORS = ("abs_rel", "rmse_m", "delta1")
_DEPTH_SUMS = ("frames", *DEPTH_ERRORS, "covered", "known")  # of pixels: with a prediction, with a truth
# The encoder's depth, and the flat ground's beside it, each against dense truth and against LiDAR; each over the whole
# image and, as KEY_eigen, over Eigen's crop.
DEPTH_SCORES = ("depth_dense", "depth_lidar", "ground_plane_dense", "ground_plane_lidar")
EIGEN_ROWS, EIGEN_COLUMNS = (0.3324324, 0.91351351), (0.0359477, 0.96405229)  # shares of height and width


def depth_errors(predicted_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray | None:
    """Return an image's [abs rel, RMSE in metres, δ1] over the pixels whose true depth is 1 to 80 m; None without any.

    Abs rel is the mean of |d - d*| / d*, δ1 the share of pixels where max(d/d*, d*/d) < 1.25 (Eigen et al. 2014, who
    also clip the prediction to the range). Both arguments are metres, [H,W]; 0 is unknown, so where the prediction is 0
    (a hole, not a distance) it is not scored.
    """
    valid = in_range(truth_m) & (predicted_m > 0)
    if not valid.any():
        return None
    truth = truth_m[valid].astype(np.float64)
    predicted = np.clip(predicted_m[valid].astype(np.float64), MIN_DEPTH_M, MAX_DEPTH_M)
    error = np.abs(predicted - truth)
    ratio = np.maximum(predicted / truth, truth / predicted)
    return np.array([(error / truth).mean(), np.sqrt((error**2).mean()), (ratio < 1.25).mean()])


def in_range(truth_m: np.ndarray) -> np.ndarray:
    """Return where a true depth is scored: 1 to 80 m."""
    return (truth_m >= MIN_DEPTH_M) & (truth_m <= MAX_DEPTH_M)


def eigen_crop(image: np.ndarray) -> np.ndarray:
    """Return the part of an image [H,W] that KITTI's "Eigen crop" keeps.

    It is the one that reproduces the figures of Eigen et al. 2014, found by Godard et al. 2017 (monodepth's
    ``--eigen_crop``). Many papers write "Eigen split" and score on the crop of Garg et al. 2016 instead, whose rows go
    from 0.408 to 0.992 of the height: lower, so more road.
    """
    height, width = image.shape
    (top, bottom), (left, right) = EIGEN_ROWS, EIGEN_COLUMNS
    return image[int(top * height) : int(bottom * height), int(left * width) : int(right * width)]


def confusion(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return how often each true class (row) was predicted as each class (column), int64 [19,19].

    `predicted` and `truth` hold trainIds, of any one shape. Pixels whose truth is void do not count.
    """
    known = truth != classes.VOID
    pairs = truth[known].astype(np.int64) * classes.COUNT + predicted[known]
    return np.bincount(pairs, minlength=classes.COUNT**2).reshape(classes.COUNT, classes.COUNT)


def class_ious(matrix: np.ndarray) -> np.ndarray:
    """Return the intersection over union of each class, [19], from a confusion matrix; NaN for one not in the truth."""
    union = matrix.sum(axis=0) + matrix.sum(axis=1) - matrix.diagonal()
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(matrix.sum(axis=1) > 0, matrix.diagonal() / union, np.nan)


def mean_iou(matrix: np.ndarray) -> float:
    """Return the mean of :func:`class_ious` over the classes that the truth holds; NaN for an empty matrix."""
    ious = class_ious(matrix)
    return float(ious[~np.isnan(ious)].mean()) if not np.isnan(ious).all() else float("nan")


def pixel_accuracy(matrix: np.ndarray) -> float:
    """Return the share of pixels whose class is right; NaN for an empty matrix."""
    return float(matrix.trace() / matrix.sum()) if matrix.any() else float("nan")


class Scores:
    """Depth and class scores of many frames: sums that can be written as JSON and added up over drives.

    Depth errors are means over images of :func:`depth_errors`; coverage and classes are counted on all pixels together.
    """

    def __init__(self) -> None:
        keys = [key + crop for key in DEPTH_SCORES for crop in ("", "_eigen")]
        self.depth = {key: np.zeros(len(_DEPTH_SUMS)) for key in keys}
        self.class_frames = 0
        self.confusion = np.zeros((classes.COUNT, classes.COUNT), np.int64)

    def add_frame(
        self, depth: np.ndarray, cls: np.ndarray, K: np.ndarray, truth: Truth, scale: Scale, camera_height_m: float
    ) -> None:
        """Count what is known of a frame: its classes, its depth, and flat ground where it has a depth.

        Args:
            depth: as stored [H,W], in the unit of `scale`, 0 where there is none.
            cls: trainIds [H,W].
            K: intrinsics [3,3].
            truth: of the same frame.
            scale: how depth came to its unit.
            camera_height_m: of the camera over the ground.
        """
        if truth.depth_source:
            flat_m = np.where(depth > 0, ground_plane_depth(cls, K, camera_height_m), 0)
            depth_m = depth * scale.scoring_factor(depth, truth.depth_m)
            self.add_depth(f"depth_{truth.depth_source}", depth_m, truth.depth_m)
            self.add_depth(f"ground_plane_{truth.depth_source}", flat_m, truth.depth_m)
        if truth.has_cls:
            self.add_classes(cls, truth.cls)

    def add_depth(self, key: str, predicted_m: np.ndarray, truth_m: np.ndarray) -> None:
        """Count a frame's depth [H,W] against a truth under a key of DEPTH_SCORES, if it has a valid pixel."""
        whole, crop = (predicted_m, truth_m), (eigen_crop(predicted_m), eigen_crop(truth_m))
        for name, (predicted, truth) in ((key, whole), (f"{key}_eigen", crop)):
            known = in_range(truth)
            errors = depth_errors(predicted, truth)
            frame = (0, 0, 0, 0) if errors is None else (1, *errors)
            self.depth[name] += [*frame, (known & (predicted > 0)).sum(), known.sum()]

    def add_classes(self, predicted: np.ndarray, truth: np.ndarray) -> None:
        """Count a frame's classes [H,W]."""
        self.class_frames += 1
        self.confusion += confusion(predicted, truth)

    def sums(self) -> dict[str, Any]:
        """Return everything as JSON-able numbers, for :meth:`add_sums` of another one."""
        return {
            "depth": {key: sums.tolist() for key, sums in self.depth.items()},
            "class_frames": self.class_frames,
            "confusion": self.confusion.tolist(),
        }

    def add_sums(self, sums: dict[str, Any]) -> None:
        """Add what :meth:`sums` of another one returned."""
        for key, values in sums["depth"].items():
            self.depth[key] += values
        self.class_frames += sums["class_frames"]
        self.confusion += np.array(sums["confusion"])

    def report(self) -> dict[str, Any]:
        """Return the scores: DEPTH_SCORES, whole and cropped, and classes; null where no frame has the truth."""
        scores: dict[str, Any] = {}
        for key, (frames, *errors, covered, known) in self.depth.items():
            scores[key] = {
                "frames": int(frames),
                **{name: float(error / frames) for name, error in zip(DEPTH_ERRORS, errors, strict=True)},
                "coverage": float(covered / known),
            } if frames else None  # fmt: skip
        ious = class_ious(self.confusion)
        present = {name: float(iou) for name, iou in zip(classes.NAMES, ious, strict=True) if not np.isnan(iou)}
        scores["classes"] = {
            "frames": self.class_frames,
            "mean_iou": mean_iou(self.confusion),
            "pixel_accuracy": pixel_accuracy(self.confusion),
            "iou": present,
        } if present else None  # fmt: skip
        return scores


def summary_line(report: Mapping[str, Any]) -> str:
    """Return a line for the log about a :meth:`Scores.report`."""
    parts = [
        f"depth abs rel {depth['abs_rel']:.3f} (flat ground {report[f'ground_plane_{source}']['abs_rel']:.3f}), "
        f"RMSE {depth['rmse_m']:.2f} m, δ1 {depth['delta1']:.3f} against {source}, coverage {depth['coverage']:.1%}"
        for source in ("dense", "lidar")
        if (depth := report[f"depth_{source}"])
    ]
    if report["classes"]:
        parts.append(f"mean IoU {report['classes']['mean_iou']:.3f} of {len(report['classes']['iou'])} classes")
    return ", ".join(parts) or "no truth to score against"
