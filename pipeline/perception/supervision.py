"""Choose the training targets of the encoder's heads, and load a teacher whose classes are targets."""

from collections.abc import Set
from enum import Enum

import numpy as np
import torch
from torch import nn

from models.encoder.heads import GroundDepth
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera
from pipeline.perception.examples import Classify
from pipeline.perception.perceive import perceive
from pipeline.perception.weights import Source, load_weights, part_without_weights
from pipeline.sections import encoder as section
from pipeline.sections.encoder import Weights


class Supervision(Enum):
    """Training target of a head, or the reason why the head is not fitted."""

    DENSE_DEPTH = "dense depth"
    LIDAR = "LiDAR"
    CLASS_LABELS = "class labels"
    TEACHER = "the teacher's classes"
    FILE = "not fitted, weights from a file"
    FLAT_GROUND = "not fitted, depth of flat ground"

    @property
    def fits(self) -> bool:
        """Return whether the head is fitted."""
        return self not in (Supervision.FILE, Supervision.FLAT_GROUND)


GROUND_TRUTH = {
    "depth_head": {"depth": Supervision.DENSE_DEPTH, "lidar": Supervision.LIDAR},
    "class_head": {"cls": Supervision.CLASS_LABELS},
}
_ALTERNATIVE = {"depth_head": "a drive with LiDAR", "class_head": "an encoder.teacher and a drive in colour"}


def choose(
    model: nn.Module, weights: Weights | None, ground_truth: Set[str], *, teacher: bool, frozen: bool
) -> dict[str, Supervision]:
    """Enable gradients of the parts of `model` that the fit changes; return head → :func:`supervision`.

    `frozen` excludes the backbone. Raises InputError if nothing is left to fit.
    """
    chosen = {head: supervision(head, model, weights, ground_truth, teacher=teacher) for head in GROUND_TRUTH}
    model.get_submodule("backbone").requires_grad_(not frozen)
    for head, target in chosen.items():
        model.get_submodule(head).requires_grad_(target.fits)
        if target is Supervision.FILE and not frozen:
            print(
                f"note: the {head} is not fitted, but its backbone is. encoder.frozen: true keeps the weights of both",
                flush=True,
            )
    if not any(parameter.requires_grad for parameter in model.parameters()):
        raise InputError("nothing is left to fit", "encoder", "Set encoder.epochs: 0 to use the weights as they are")
    return chosen


def supervision(
    head: str, model: nn.Module, weights: Weights | None, ground_truth: Set[str], *, teacher: bool
) -> Supervision:
    """Return the training target of a head.

    A published file of the head takes precedence over ground truth; a project checkpoint only initialises the fit.

    Args:
        head: a key of GROUND_TRUTH.
        model: a unified encoder.
        weights: the files that fill it.
        ground_truth: which of depth, lidar and cls at least one training frame has.
        teacher: whether a teacher supplies classes.

    Raises InputError if there is neither a target nor a file, or only the head's file without its backbone's.
    """
    target = next((target for kind, target in GROUND_TRUTH[head].items() if kind in ground_truth), None)
    if target is None and head == "class_head" and teacher:
        target = Supervision.TEACHER
    if target:
        return Supervision.FILE if weights and head in weights.parts else target
    part = part_without_weights(model, weights, (head, "backbone"))
    if part is None:
        return Supervision.FILE
    if part == head and any(isinstance(module, GroundDepth) for module in model.get_submodule(head).modules()):
        return Supervision.FLAT_GROUND
    kinds = " or ".join(target.value for target in GROUND_TRUTH[head].values())
    fix = f"Name a fitted {part} in encoder.weights, or add {_ALTERNATIVE[head]}"
    raise InputError(f"no training drive has {kinds}, and encoder.weights has no {part}", "encoder", fix)


def load_teacher(settings: section.Teacher) -> tuple[Classify, list[Source]]:
    """Return the classifier of a fitted encoder, and the files of its weights. Raises InputError."""
    with error_context("encoder.teacher.backbone"):
        model = UnifiedEncoder(settings.backbone)
    with error_context("encoder.teacher.weights"):
        part = part_without_weights(model, settings.weights, ("backbone", "class_head"))
        if part:
            raise InputError(f"no file for the {part}", fix="Name one: a teacher is not fitted")
        sources = load_weights(model, settings.backbone, settings.weights)
    model.to("cuda" if torch.cuda.is_available() else "cpu").eval().requires_grad_(False)

    def classify(image: np.ndarray, camera: Camera) -> np.ndarray:
        cls: np.ndarray = perceive(model, image[None], camera)[1][0]
        return cls

    return classify, sources
