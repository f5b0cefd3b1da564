"""What teaches the encoder's heads, and a fitted encoder that teaches classes to another."""

from collections.abc import Set

import numpy as np
import torch
from torch import nn

from models.encoder.ground_depth import GroundDepth
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError, error_context
from pipeline.encoder.examples import Teacher
from pipeline.encoder.perceive import perceive
from pipeline.encoder.weights import Setting, Source, fill, unnamed

TRUTHS = {"depth_head": {"depth": "dense depth", "lidar": "LiDAR"}, "class_head": {"cls": "class truth"}}
TEACHER, FILE, FLAT_GROUND = "the teacher's classes", "its file", "flat ground"
FITTED_TO = {truth for truths in TRUTHS.values() for truth in truths.values()} | {TEACHER}
_REMEDY = {"depth_head": "a drive with LiDAR", "class_head": "an encoder.teacher and a drive in colour"}


def choose(model: nn.Module, weights: Setting, known: Set[str], *, teacher: bool, frozen: bool) -> dict[str, str]:
    """Let the gradients flow to those parts of `model` that are to be fitted; return head → :func:`what_teaches` it.

    `frozen`: the backbone stays as it is. Raises InputError if nothing is left to fit.
    """
    lessons = {head: what_teaches(head, model, weights, known, teacher=teacher) for head in TRUTHS}
    model.get_submodule("backbone").requires_grad_(not frozen)
    for head, lesson in lessons.items():
        model.get_submodule(head).requires_grad_(lesson in FITTED_TO)
        if lesson == FILE and not frozen:
            print(
                f"note: the {head} is not fitted while its backbone is. "
                "encoder.frozen: true keeps what encoder.weights gives",
                flush=True,
            )
    if not any(parameter.requires_grad for parameter in model.parameters()):
        raise InputError("nothing is left to fit: encoder.epochs: 0 uses the weights as they are")
    return lessons


def what_teaches(head: str, model: nn.Module, weights: Setting, known: Set[str], *, teacher: bool) -> str:
    """Return what teaches a head of `model`, by which it is fitted, or stays as it is.

    ==================  ======================================================================
    a truth of TRUTHS   fitted to what the training drives know of depth or classes
    TEACHER             fitted to the classes that a teacher sees
    FILE                stays as a file of setting `weights` has it
    FLAT_GROUND         stays as it is made, which without any fitting is the depth of flat ground
    ==================  ======================================================================

    Args:
        head: of TRUTHS.
        model: a unified encoder.
        weights: the files that fill it. One that names the head goes before a truth.
        known: what of depth, lidar, cls some training frame knows.
        teacher: whether there is one.

    Raises InputError if there is nothing: neither a truth nor weights, or weights for a backbone that is not theirs.
    """
    published = isinstance(weights, dict) and head in weights
    truth = next((name for what, name in TRUTHS[head].items() if what in known), None)
    if not truth and head == "class_head" and teacher:
        truth = TEACHER
    if truth:
        return FILE if published else truth
    part = unnamed(model, weights, (head, "backbone"))
    if part is None:
        return FILE
    if part == head and any(isinstance(module, GroundDepth) for module in model.get_submodule(head).modules()):
        return FLAT_GROUND
    raise InputError(
        f"no training drive has {' or '.join(TRUTHS[head].values())}, and encoder.weights names no {part}: "
        f"name a fitted one there, or add {_REMEDY[head]}"
    )


def load_teacher(backbone: str, weights: Setting, key: str) -> tuple[Teacher, list[Source]]:
    """Return a fitted encoder as a :func:`class_teacher`, and the files it came from.

    `key` is the setting's name in params.yaml. Raises InputError if a part is missing that classes need.
    """
    with error_context(f"{key}.backbone"):
        model = UnifiedEncoder(backbone)
    part = unnamed(model, weights, ("backbone", "class_head"))
    if part:
        raise InputError(f"{key}.weights names no {part}, and nothing fits a teacher: name one")
    sources = fill(model, backbone, weights, f"{key}.weights")
    model.to("cuda" if torch.cuda.is_available() else "cpu").eval().requires_grad_(False)
    return class_teacher(model), sources


def class_teacher(model: nn.Module) -> Teacher:
    """Return a teacher that gives a frame the classes that `model` sees in it."""

    def teach(image: np.ndarray, K: np.ndarray) -> np.ndarray:
        cls: np.ndarray = perceive(model, image[None], K)[1][0]
        return cls

    return teach
