"""Measure the errors of depth and classes against ground truth."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.ingest.truth import Truth

# Least true depth in metres that is scored.
MIN_DEPTH_M = 1.0
# Largest true depth in metres that is scored.
MAX_DEPTH_M = 80.0
# Names of the errors of an image's depth: mean relative error, root mean square error in metres,
# and share of accurate pixels.
DEPTH_ERRORS = ("abs_rel", "rmse_m", "delta1")
# Names of the values that are summed over frames: the number of frames with errors, these errors,
# the number of pixels with a true and a predicted depth, and that of pixels with a true depth.
DEPTH_SUMS = ("frames", *DEPTH_ERRORS, "covered", "known")
# Names of the scores of depth: the encoder's depth and the flat-ground baseline, each against dense
# truth and LiDAR, in Eigen's crop.
DEPTH_SCORES = ("depth_dense", "depth_lidar", "ground_plane_dense", "ground_plane_lidar")
# Start and end of the rows of Eigen's crop, as shares of the height.
EIGEN_ROWS = (0.3324324, 0.91351351)
# Start and end of the columns of Eigen's crop, as shares of the width.
EIGEN_COLUMNS = (0.0359477, 0.96405229)


def compute_depth_errors(predicted_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray | None:
    """Return the errors of an image's depth, DEPTH_ERRORS: [abs rel, RMSE in metres, δ1].

    Abs rel is the mean of |d - d*| / d*, where d is the predicted and d* the true depth. δ1 is the
    share of pixels with max(d/d*, d*/d) < 1.25. Pixels are scored if their true depth is 1 to 80 m
    and their predicted depth is known. Predictions are clipped to this range, as by Eigen et al.
    2014. The result is None if no pixel is scored. Both arguments are depths [H,W] in metres, of
    which 0 is unknown.
    """
    valid = is_in_range(truth_m) & (predicted_m > 0)
    if not valid.any():
        return None
    truth = truth_m[valid].astype(np.float64)
    predicted = np.clip(predicted_m[valid].astype(np.float64), MIN_DEPTH_M, MAX_DEPTH_M)
    error = np.abs(predicted - truth)
    ratio = np.maximum(predicted / truth, truth / predicted)
    return np.array([(error / truth).mean(), np.sqrt((error**2).mean()), (ratio < 1.25).mean()])


def is_in_range(truth_m: np.ndarray) -> np.ndarray:
    """Return which true depths are scored, which are those from 1 to 80 m."""
    return (truth_m >= MIN_DEPTH_M) & (truth_m <= MAX_DEPTH_M)


def crop_eigen(image: np.ndarray) -> np.ndarray:
    """Return KITTI's "Eigen crop" of an image [H,W].

    It reproduces the numbers of Eigen et al. 2014 and was found by Godard et al. 2017 (monodepth's
    ``--eigen_crop``). Many papers that write "Eigen split" use the crop of Garg et al. 2016
    instead. That crop has the rows from 0.408 to 0.992 of the height, and so more of the road.
    """
    height, width = image.shape
    top, bottom = EIGEN_ROWS
    left, right = EIGEN_COLUMNS
    return image[int(top * height) : int(bottom * height), int(left * width) : int(right * width)]


def count_confusion(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the confusion matrix, int64 [19,20].

    It has a row for each true class and a column for each predicted class, of which the last one is
    void. `predicted` and `truth` hold trainIds and have the same shape. Pixels whose true class is
    void do not count.
    """
    columns = classes.COUNT + 1
    counted = truth < classes.COUNT
    row = truth[counted].astype(np.int64)
    column = np.minimum(predicted[counted], classes.COUNT)
    counts = np.bincount(row * columns + column, minlength=classes.COUNT * columns)
    return counts.reshape(classes.COUNT, columns)


def class_ious(matrix: np.ndarray) -> np.ndarray:
    """Return the intersection over union of each class [19] of a confusion matrix.

    It is NaN for a class that the truth lacks.
    """
    intersection = matrix.diagonal()
    predicted = matrix.sum(axis=0)[: classes.COUNT]
    true = matrix.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(true > 0, intersection / (predicted + true - intersection), np.nan)


class Scores:
    """Sums of the errors of many frames, which can be stored as JSON and added over drives.

    Errors of depth are computed for each image and averaged over images. Coverage and the scores of
    classes are computed over the pixels of all images.
    """

    def __init__(self) -> None:
        self.sums = {key: np.zeros(len(DEPTH_SUMS)) for key in DEPTH_SCORES}
        self.sums["class_frames"] = np.zeros(1)
        self.sums["confusion"] = np.zeros((classes.COUNT, classes.COUNT + 1))

    def add_frame(self, depth_m: np.ndarray, cls: np.ndarray, camera: Camera, truth: Truth) -> None:
        """Add the predicted classes and depth [H,W] of a frame, and the flat-ground baseline.

        A depth of 0 is unknown. The baseline is scored only at pixels whose predicted depth is
        known, so that both are scored at the same pixels.
        """
        if truth.depth_source:
            flat_m = np.where(depth_m > 0, ground_plane_depth(cls, camera), 0)
            self.add_depth(f"depth_{truth.depth_source}", depth_m, truth.depth_m)
            self.add_depth(f"ground_plane_{truth.depth_source}", flat_m, truth.depth_m)
        if (truth.cls != classes.VOID).any():
            self.add_classes(cls, truth.cls)

    def add_depth(self, key: str, predicted_m: np.ndarray, truth_m: np.ndarray) -> None:
        """Add the errors of a frame's depth [H,W] to the sums of `key`, one of DEPTH_SCORES."""
        predicted = crop_eigen(predicted_m)
        truth = crop_eigen(truth_m)
        known = is_in_range(truth)
        covered = known & (predicted > 0)
        frames = 1
        errors = compute_depth_errors(predicted, truth)
        if errors is None:
            frames = 0
            errors = np.zeros(len(DEPTH_ERRORS))
        self.sums[key] += [frames, *errors, covered.sum(), known.sum()]

    def add_classes(self, predicted: np.ndarray, truth: np.ndarray) -> None:
        """Add the classes [H,W] of a frame."""
        self.sums["class_frames"] += 1
        self.sums["confusion"] += count_confusion(predicted, truth)

    def add_sums(self, sums: Mapping[str, Any]) -> None:
        """Add the `sums` of another instance, arrays or lists."""
        for key, values in sums.items():
            self.sums[key] += values

    def to_report(self) -> dict[str, Any]:
        """Return the scores of depth, DEPTH_SCORES, and of classes.

        A score is None if no frame has its ground truth.
        """
        scores: dict[str, Any] = dict.fromkeys([*DEPTH_SCORES, "classes"])
        for key in DEPTH_SCORES:
            sums = dict(zip(DEPTH_SUMS, self.sums[key].tolist(), strict=True))
            frames = sums["frames"]
            if frames:
                means = {name: sums[name] / frames for name in DEPTH_ERRORS}
                coverage = sums["covered"] / sums["known"]
                scores[key] = {"frames": int(frames), **means, "coverage": coverage}

        matrix = self.sums["confusion"]
        ious = zip(classes.NAMES, class_ious(matrix).tolist(), strict=True)
        present = {name: iou for name, iou in ious if not np.isnan(iou)}
        if present:
            scores["classes"] = {
                "frames": int(self.sums["class_frames"][0]),
                "mean_iou": float(np.mean([*present.values()])),  # over the classes in the truth
                "pixel_accuracy": float(matrix.trace() / matrix.sum()),
                "iou": present,
            }
        return scores
