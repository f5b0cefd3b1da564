"""Scores of predicted depth and classes against a truth."""

from typing import Any

import numpy as np

from pipeline.camera import classes

MIN_DEPTH_M, MAX_DEPTH_M = 1.0, 80.0
DEPTH_ERRORS = ("abs_rel", "rmse_m", "delta1")
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
    valid = (truth_m >= MIN_DEPTH_M) & (truth_m <= MAX_DEPTH_M) & (predicted_m > 0)
    if not valid.any():
        return None
    truth = truth_m[valid].astype(np.float64)
    predicted = np.clip(predicted_m[valid].astype(np.float64), MIN_DEPTH_M, MAX_DEPTH_M)
    error = np.abs(predicted - truth)
    ratio = np.maximum(predicted / truth, truth / predicted)
    return np.array([(error / truth).mean(), np.sqrt((error**2).mean()), (ratio < 1.25).mean()])


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

    Depth errors are means over images of :func:`depth_errors`; classes are scored on all pixels together.
    """

    def __init__(self) -> None:
        keys = [key + crop for key in DEPTH_SCORES for crop in ("", "_eigen")]
        self.depth = {key: (0, np.zeros(len(DEPTH_ERRORS))) for key in keys}
        self.class_frames = 0
        self.confusion = np.zeros((classes.COUNT, classes.COUNT), np.int64)

    def add_depth(self, key: str, predicted_m: np.ndarray, truth_m: np.ndarray) -> None:
        """Count a frame's depth [H,W] against a truth under a key of DEPTH_SCORES, if it has a valid pixel."""
        whole, crop = (predicted_m, truth_m), (eigen_crop(predicted_m), eigen_crop(truth_m))
        for name, (predicted, truth) in ((key, whole), (f"{key}_eigen", crop)):
            errors = depth_errors(predicted, truth)
            if errors is not None:
                frames, sums = self.depth[name]
                self.depth[name] = (frames + 1, sums + errors)

    def add_classes(self, predicted: np.ndarray, truth: np.ndarray) -> None:
        """Count a frame's classes [H,W]."""
        self.class_frames += 1
        self.confusion += confusion(predicted, truth)

    def sums(self) -> dict[str, Any]:
        """Return everything as JSON-able numbers, for :meth:`add_sums` of another one."""
        return {
            "depth": {key: [frames, sums.tolist()] for key, (frames, sums) in self.depth.items()},
            "class_frames": self.class_frames,
            "confusion": self.confusion.tolist(),
        }

    def add_sums(self, sums: dict[str, Any]) -> None:
        for key, (frames, errors) in sums["depth"].items():
            own_frames, own = self.depth[key]
            self.depth[key] = (own_frames + frames, own + np.array(errors))
        self.class_frames += sums["class_frames"]
        self.confusion += np.array(sums["confusion"])

    def report(self) -> dict[str, Any]:
        """Return the scores: DEPTH_SCORES, whole and cropped, and classes; null where no frame has the truth."""
        scores: dict[str, Any] = {}
        for key, (frames, sums) in self.depth.items():
            means = dict(zip(DEPTH_ERRORS, (sums / frames).tolist(), strict=True)) if frames else {}
            scores[key] = {"frames": frames, **means} if frames else None
        ious = class_ious(self.confusion)
        present = {name: float(iou) for name, iou in zip(classes.NAMES, ious, strict=True) if not np.isnan(iou)}
        scores["classes"] = {
            "frames": self.class_frames,
            "mean_iou": mean_iou(self.confusion),
            "pixel_accuracy": pixel_accuracy(self.confusion),
            "iou": present,
        } if present else None  # fmt: skip
        return scores
