"""Weights of the unified encoder's parts: files, downloaded and verified, or the training targets of a fit."""

import http.client
import socket
import sys
from collections.abc import Sequence, Set
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, hub, nn

from models.encoder.heads import GroundDepth
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError, error_context
from pipeline.base.resume import file_hash
from pipeline.camera.camera import Camera
from pipeline.perception import perceive
from pipeline.perception.examples import Classify
from pipeline.settings.encoder import Teacher, WeightFile, Weights
from pipeline.train import checkpoint

ALL = "all"
STREET = Path("weights/street")
"""Where make street writes the encoder of real streets."""
TIMEOUT_S = 30  # without any data from the server
WRAPPERS = ("state_dict", "model")  # keys of the tensors in published files that hold more than tensors


@dataclass(frozen=True)
class Source:
    """A file of weights and the part of the encoder that it holds; ALL: a checkpoint of this project."""

    part: str
    path: str
    sha256: str


def check_available(weights: Weights | None) -> None:
    """Raise InputError if a file is missing and cannot be downloaded."""
    for part, file in _files(weights).items():
        with error_context("" if part == ALL else part):
            _check_available(file)


def load_weights(model: Any, backbone: str, weights: Weights | None) -> list[Source]:
    """Load weights into a unified encoder in place; return the files. `backbone`: its kind, a key of BACKBONES.

    Raises InputError if a file is missing, has another hash, or does not match the network tensor by tensor.
    """
    sources = []
    for part, file in _files(weights).items():
        with error_context("" if part == ALL else part, fix="Name another file"):
            sources.append(Source(part, str(file.path), fetch(file)))
            if part == ALL:
                _load_checkpoint(model, backbone, file.path)
            else:
                module = getattr(model, part)
                checkpoint.load_state(module, module.convert_names(read_published(file.path)), file.path)
    return sources


def _load_checkpoint(model: Any, backbone: str, path: Path) -> None:
    with error_context(fix="A published file needs the name of its part: weights: {backbone: FILE}"):
        saved, state = perceive.read(path)
    if saved != backbone:
        raise InputError(f"backbone is {saved!r}, expected {backbone!r}", path)
    checkpoint.load_state(model, state, path)


def part_without_weights(model: nn.Module, weights: Weights | None, parts: Sequence[str]) -> str | None:
    """Return the first of `parts` that has parameters and no file in `weights`."""
    for part in parts:
        has_parameters = any(True for _ in model.get_submodule(part).parameters())
        if has_parameters and not (weights and weights.has(part)):
            return part
    return None


def fetch(file: WeightFile) -> str:
    """Download a file if it is missing, verify it, and return its SHA-256.

    Raises InputError if the download fails or the hash differs.
    """
    _check_available(file)
    if not file.path.exists():
        _download(file)
    sha256 = file_hash(file.path)
    if file.sha256 not in (None, sha256):
        fix = "Delete the file to download it again, or correct sha256"
        raise InputError(f"SHA-256 is {sha256}, expected {file.sha256}", file.path, fix)
    return sha256


def read_published(path: Path) -> dict[str, Tensor]:
    """Return the tensors by name of a state dict, alone in its file or beside data of its training.

    Raises InputError if the file is damaged or holds anything but a state dict.
    """
    content = checkpoint.load(path)
    if isinstance(content, dict):
        state = next((content[key] for key in WRAPPERS if isinstance(content.get(key), dict)), content)
        # Monodepth2's files hold the image size beside the tensors.
        tensors = {name: value for name, value in state.items() if not isinstance(value, int | float)}
        if tensors and checkpoint.is_state(tensors):
            return tensors
    raise InputError("expected a state dict, tensors by name", path)


def _files(weights: Weights | None) -> dict[str, WeightFile]:
    """Return part → file; part ALL for a checkpoint of this project."""
    if weights is None:
        return {}
    return {ALL: weights.checkpoint} if weights.checkpoint else weights.parts


def _check_available(file: WeightFile) -> None:
    if file.path.exists():
        if not file.path.is_file():
            raise InputError("expected a regular file", file.path)
        return
    if not file.is_url:
        fix = "Make it: make street" if file.path.parent == STREET else "Put it there, or name another one"
        raise InputError("file is missing", file.path, fix)
    if not file.sha256:
        raise InputError("file is missing, and a URL without sha256 is not downloaded", file.path, _by_hand(file))


def _download(file: WeightFile) -> None:
    default_s = socket.getdefaulttimeout()
    socket.setdefaulttimeout(TIMEOUT_S)  # hub sets none
    try:
        file.path.parent.mkdir(parents=True, exist_ok=True)
        hub.download_url_to_file(file.url, str(file.path), file.sha256, progress=sys.stderr.isatty())
    except (OSError, RuntimeError, ValueError, http.client.HTTPException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"cannot download {file.url} ({reason})", file.path, _by_hand(file)) from error
    finally:
        socket.setdefaulttimeout(default_s)


def _by_hand(file: WeightFile) -> str:
    return f"Put the file there: curl --create-dirs -L -o {file.path} {file.url}"


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

    A published file of the head takes precedence over ground truth, unless a teacher supplies classes: then, like a
    project checkpoint, it only initialises the fit.

    Args:
        head: a key of GROUND_TRUTH.
        model: a unified encoder.
        weights: the files that fill it.
        ground_truth: which of depth, lidar and cls at least one training frame has.
        teacher: whether a teacher supplies classes.

    Raises InputError if there is neither a target nor a file, or only the head's file without its backbone's.
    """
    target = next((target for kind, target in GROUND_TRUTH[head].items() if kind in ground_truth), None)
    taught = teacher and head == "class_head"
    if target is None and taught:
        target = Supervision.TEACHER
    if target:
        return Supervision.FILE if weights and head in weights.parts and not taught else target
    part = part_without_weights(model, weights, (head, "backbone"))
    if part is None:
        return Supervision.FILE
    if part == head and any(isinstance(module, GroundDepth) for module in model.get_submodule(head).modules()):
        return Supervision.FLAT_GROUND
    kinds = " or ".join(target.value for target in GROUND_TRUTH[head].values())
    fix = f"Name a fitted {part} in encoder.weights, or add {_ALTERNATIVE[head]}"
    raise InputError(f"no training drive has {kinds}, and encoder.weights has no {part}", "encoder", fix)


def load_teacher(settings: Teacher) -> Classify:
    """Return the classifier of a fitted encoder. Raises InputError."""
    with error_context("encoder.teacher.backbone"):
        model = UnifiedEncoder(settings.backbone)
    with error_context("encoder.teacher.weights"):
        part = part_without_weights(model, settings.weights, ("backbone", "class_head"))
        if part:
            raise InputError(f"no file for the {part}", fix="Name one: a teacher is not fitted")
        load_weights(model, settings.backbone, settings.weights)
    model.to("cuda" if torch.cuda.is_available() else "cpu").eval().requires_grad_(False)

    def classify(image: np.ndarray, camera: Camera) -> np.ndarray:
        cls: np.ndarray = perceive.perceive(model, image[None], camera)[1][0]
        return cls

    return classify
