"""Networks of Hugging Face as encoders, given by a name on its hub or by a folder.

An encoder is a pair of networks, or a backbone with heads of this project. A network is described
by ``{"config", "mean", "std"}``: its configuration, and the normalisation of its images. From this
description it can be built again without the hub. No code of the hub is run, and files of weights
may hold only tensors.
"""

import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from types import ModuleType
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.encoder.heads import CellClasses, CellDepth, ray_slopes, resize_map, scaled_by_focal
from pipeline.base.checkout import in_checkout
from pipeline.base.errors import InputError
from pipeline.camera.classes import COUNT, NAMES

# Normalisation of images in most networks.
IMAGENET = {"image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225]}
# Normalisation that does not change images from 0 to 1.
IDENTITY = {"image_mean": [0.0] * 3, "image_std": [1.0] * 3}
# Number of pixels per feature, along each side, of the map that the heads of this project read.
STRIDE = 4
# Number of maps of a backbone whose sum is this map.
LEVELS = 4
# Number of channels of this map.
WIDTH = 64
# Beginning of the names of weights that published files may lack: norms that a fit trains.
UNPUBLISHED = "hidden_states_norms."
# Least probability of a class. Its logarithm is finite, so it can be interpolated.
LEAST_PROBABILITY = 1e-6


def import_transformers() -> ModuleType:
    """Return the package transformers, silenced. Raises InputError if it is missing."""
    try:
        import transformers
    except ImportError as error:
        raise InputError(
            "this backbone needs the package transformers: pip install '.[pretrained]'"
        ) from error
    transformers.logging.set_verbosity_error()  # type: ignore[no-untyped-call]
    transformers.logging.disable_progress_bar()  # type: ignore[no-untyped-call]
    logging.getLogger("huggingface_hub").setLevel(logging.ERROR)
    return transformers


@contextmanager
def as_input_error(name: str | Path, action: str = "load") -> Iterator[None]:
    """Turn exceptions of transformers, which have many types, into an InputError of one line."""
    try:
        yield
    except Exception as error:
        reason = type(error).__name__
        lines = str(error).strip().splitlines()
        if isinstance(error, UnpicklingError):  # its text explains how to run the code
            reason = "a file is damaged, or has more than tensors"
        elif lines:
            reason = lines[0]
        raise InputError(f"cannot {action} {str(name)!r}: {reason}") from error


def check_network(name: str) -> None:
    """Raise InputError if `name` can be neither a folder nor a name on the hub.

    If it can only be a folder, that must have a configuration. Names on the hub are not looked up.
    Raises InputError, too, if the package transformers is missing.
    """
    import_transformers()
    path = Path(name)
    folder = in_checkout(path)
    is_folder = path.is_absolute() or folder.parent.is_dir() or len(path.parts) > 2
    if is_folder and not (folder / "config.json").is_file():
        raise InputError(
            f"{name!r} is not a folder with a config.json, nor a name of Hugging Face's hub"
        )


def describe_network(name: str) -> tuple[Path, dict[str, Any], list[str]]:
    """Return the folder of a network, its description, and its sources. Raises InputError.

    A network that is not a folder is downloaded from the hub. Its revision there is the source.
    """
    check_network(name)
    folder = in_checkout(Path(name))
    sources = []
    with as_input_error(name):
        if not folder.is_dir():
            from huggingface_hub import snapshot_download

            patterns = ["*config.json", "*.safetensors*", "pytorch_model*"]
            folder = Path(snapshot_download(name, allow_patterns=patterns))
            sources = [f"https://huggingface.co/{name}/tree/{folder.name}"]
        auto = import_transformers().AutoConfig
        config = auto.from_pretrained(folder, trust_remote_code=False)
        content = json.loads(config.to_json_string(use_diff=False))
        # The path of the folder is no property of the network.
        del content["_name_or_path"]

        # The file of the image processor, if there is one, has the normalisation.
        images = IMAGENET
        file = folder / "preprocessor_config.json"
        if file.is_file():
            images = json.loads(file.read_text())
            normalised = images.get("do_normalize", "image_mean" in images)
            images = IMAGENET | images if normalised else IDENTITY
    description = {"config": content, "mean": images["image_mean"], "std": images["image_std"]}
    return folder, description, sources


class Network(nn.Module):
    """A network of transformers, and the normalisation of its images.

    Images are padded at the right and at the bottom, to sides that the network can divide.
    """

    mean_std: Tensor

    def __init__(
        self, auto: str, description: Mapping[str, Any], folder: Path | None = None
    ) -> None:
        """Build the network by the class `auto` of transformers.

        The weights are read from `folder`. They are random if it is None.
        """
        super().__init__()
        library = import_transformers()
        config = library.AutoConfig.for_model(**description["config"])
        patch = getattr(getattr(config, "backbone_config", None) or config, "patch_size", None)
        # A ViT divides the image into patches. Other backbones halve it up to five times.
        self.multiple = 32
        if isinstance(patch, int) and patch > STRIDE:
            self.multiple = math.lcm(2 * patch, STRIDE)
        # The maps of a backbone are spread evenly over its stages, and include the last.
        if auto == "AutoBackbone":
            stages = len(getattr(config, "stage_names", ())) - 1  # the stem does not count
            levels = [max(1, stages * level // LEVELS) for level in range(1, LEVELS + 1)]
            config.out_indices = sorted(set(levels))

        with as_input_error(folder or config.model_type):
            self.network = getattr(library, auto).from_config(config, trust_remote_code=False)
            if folder:
                self.network, report = type(self.network).from_pretrained(
                    folder,
                    config=config,
                    dtype=torch.float32,
                    weights_only=True,
                    output_loading_info=True,
                )
                lacking = [key for key in report["missing_keys"] if not key.startswith(UNPUBLISHED)]
                if lacking:
                    raise InputError(
                        f"its weights lack {min(lacking)}, {len(lacking)} tensors in all"
                    )
        mean_std = torch.tensor([description["mean"], description["std"]])[..., None, None]
        self.register_buffer("mean_std", mean_std, persistent=False)  # [2,3,1,1]

    def forward(self, image: Tensor) -> Any:
        """Return the network's output for an RGB image uint8 [B,3,H,W]."""
        mean, std = self.mean_std
        height, width = image.shape[-2:]
        normalised = (image.float() / 255 - mean) / std
        padding = (0, -width % self.multiple, 0, -height % self.multiple)
        padded = F.pad(normalised, padding)
        with as_input_error(self.network.config.model_type, "run"):
            return self.network(padded)

    def pad_size(self, size: Sequence[int]) -> torch.Size:
        """Return the size of an image of `size` (H, W) after padding."""
        return torch.Size(side + -side % self.multiple for side in size)

    def enlarge_map(self, x: Tensor, size: Sequence[int]) -> Tensor:
        """Interpolate a map [B,C,h,w] of the padded image, and crop it to the image: [B,C,H,W].

        `size` is (H, W) of the image.
        """
        height, width = self.pad_size(size)
        h, w = x.shape[-2:]
        # The map must have the shape of the image. That of plain DPT has not: DPT takes 4 x 16
        # patches for a square of 8 x 8.
        if abs(h * width - w * height) > height + width:
            kind = self.network.config.model_type
            raise InputError(f"{kind!r} returns {h} x {w} pixels for {height} x {width}")
        return resize_map(x, (height, width))[..., : size[0], : size[1]]


class Pair(nn.Module):
    """An encoder of two networks: a metric Depth Anything, and a segmenter of Cityscapes' classes.

    Raises InputError for other networks.
    """

    def __init__(
        self,
        architecture: Mapping[str, Any],
        depth: Path | None = None,
        classes: Path | None = None,
    ) -> None:
        super().__init__()
        _check_pair(architecture["depth"]["config"], architecture["classes"]["config"])
        self.depth = Network("AutoModelForDepthEstimation", architecture["depth"], depth)
        self.classes = Network("AutoModelForSemanticSegmentation", architecture["classes"], classes)
        self.focal_by_width = architecture["focal_by_width"]

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        size = image.shape[-2:]
        depth = self.depth(image).predicted_depth[:, None]
        depth = self.depth.enlarge_map(depth, size)[:, 0]
        probabilities = self.classes(image).logits.float().softmax(dim=1)
        logits = probabilities.clamp(min=LEAST_PROBABILITY).log()
        logits = self.classes.enlarge_map(logits, size)
        return scaled_by_focal(depth, K, self.focal_by_width), logits


def _check_pair(depth: Mapping[str, Any], classes: Mapping[str, Any]) -> None:
    """Raise InputError unless depth is in metres and the classes are those of Cityscapes.

    `depth` and `classes` are the configurations of the two networks.
    """
    kind = depth["model_type"]
    estimate = depth.get("depth_estimation_type")
    if kind != "depth_anything" or estimate != "metric":
        problem = f"is no metric Depth Anything (got {kind!r}, depth_estimation_type {estimate!r})"
        raise InputError(problem, "depth", "Name one, such as that of docs/models.md")

    labels = classes.get("id2label", {})
    names = [labels[number].lower() for number in sorted(labels, key=int)]
    if names != [*NAMES]:
        got = f"{len(names)}: {', '.join(names[:3])}, …"
        expected = f"{COUNT}: {', '.join(NAMES[:3])}, …"
        problem = f"has other classes than Cityscapes (got {got}; expected {expected})"
        fix = "Name another network, or the classes by id2label in its config.json"
        raise InputError(problem, "classes", fix)


class HuggingFace(nn.Module):
    """The paper's unified encoder: a backbone that a depth head and a class head share."""

    def __init__(self, architecture: Mapping[str, Any], folder: Path | None = None) -> None:
        super().__init__()
        self.backbone = Network("AutoBackbone", architecture["model"], folder)
        channels = self.backbone.network.channels
        self.depth_head = Pyramid(channels, CellDepth(WIDTH, STRIDE))
        self.class_head = Pyramid(channels, CellClasses(WIDTH, STRIDE))

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        height, width = image.shape[-2:]
        maps = self.backbone(image).feature_maps
        rays = ray_slopes(K, self.backbone.pad_size((height, width)))
        depth = self.depth_head(maps, rays)
        logits = self.class_head(maps, rays)
        return depth[..., :height, :width], logits[..., :height, :width]


class Pyramid(nn.Module):
    """Adds maps of any strides, after enlarging them to STRIDE, and applies a head to the sum."""

    def __init__(self, channels: Sequence[int], head: nn.Module) -> None:
        super().__init__()
        self.sides = nn.ModuleList(nn.Conv2d(count, WIDTH, 1) for count in channels)
        self.smooth = nn.Sequential(
            nn.Conv2d(WIDTH + 2, WIDTH, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(WIDTH, WIDTH, 3, padding=1),
            nn.ReLU(),
        )
        self.head = head

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return the head's output for maps of the image of `rays` [B,2,H,W]."""
        size = [side // STRIDE for side in rays.shape[-2:]]
        sides = [resize_map(side(x), size) for side, x in zip(self.sides, maps, strict=True)]
        total = torch.stack(sides).sum(dim=0)
        features = self.smooth(torch.cat([total, resize_map(rays, size)], dim=1))
        return self.head(features, rays)


def create_pair(
    depth: str, classes: str, focal_by_width: float
) -> tuple[dict[str, Any], nn.Module]:
    """Return description and network of a pair, from the networks named `depth` and `classes`.

    `focal_by_width` is the focal length of the training images of `depth`, divided by their width.
    Raises InputError if a network cannot be loaded, or is no network of a pair.
    """
    depth_folder, depth_network, depth_sources = describe_network(depth)
    classes_folder, classes_network, classes_sources = describe_network(classes)
    architecture: dict[str, Any] = {
        "backbone": "pair",
        "depth": depth_network,
        "classes": classes_network,
        "focal_by_width": focal_by_width,
        "sources": depth_sources + classes_sources,
    }
    return architecture, Pair(architecture, depth_folder, classes_folder)


def create_backbone(model: str) -> tuple[dict[str, Any], nn.Module]:
    """Return description and network of a backbone with random heads. Raises InputError."""
    folder, description, sources = describe_network(model)
    architecture = {"backbone": "hugging_face", "model": description, "sources": sources}
    published = any(folder.glob("*.safetensors")) or any(folder.glob("pytorch_model*.bin"))
    return architecture, HuggingFace(architecture, folder if published else None)
