"""DINOv2 (Oquab et al. 2023) with its authors' linear heads: KITTI depth in metres and ADE20K classes.

The backbone is transformers' Dinov2Model, by name or folder. The heads are the authors' files, for instance
``dinov2_vits14_kitti_linear_head.pth`` and ``dinov2_vits14_ade20k_linear_head.pth``.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy._core.multiarray import scalar
from torch import Tensor, nn

from models.encoder.heads import scaled_by_focal
from models.encoder.hugging_face import CityscapesLogits, Network, describe, loading
from models.encoder.rtmonodepth_s import KITTI_FOCAL
from pipeline.base.errors import InputError

MIN_DEPTH_M, MAX_DEPTH_M, BINS = 0.001, 80.0, 256  # of the KITTI heads; the authors' hub code has NYU's maximum of 10 m
ADE20K = Path(__file__).with_name("ade20k.txt")  # names of its 150 classes, a line each, as the heads number them


class DinoV2(nn.Module):
    """The backbone, and the heads with the authors' names of tensors."""

    def __init__(self, architecture: Mapping[str, Any], folder: Path | None = None) -> None:
        """`folder` holds the backbone's weights; without it they are random. The heads' weights always are."""
        super().__init__()
        self.backbone = Network("AutoModel", architecture["model"], folder)
        width, names = self.backbone.network.config.hidden_size, ADE20K.read_text(encoding="utf-8").splitlines()
        self.depth_head = nn.ModuleDict({"conv_depth": nn.Conv2d(2 * width, BINS, 1)})
        self.class_head = nn.ModuleDict({"bn": nn.BatchNorm2d(width), "conv_seg": nn.Conv2d(width, len(names), 1)})
        self.cityscapes = CityscapesLogits(names)

    def forward(self, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        size, patch = image.shape[-2:], self.backbone.network.config.patch_size
        states = self.backbone(image, output_hidden_states=True)
        last, normed = states.hidden_states[-1], states.last_hidden_state  # [B,1+h·w,C], the class token first
        summary = last[:, :1].expand(-1, last.shape[1] - 1, -1)
        tokens = torch.cat([last[:, 1:], summary, normed[:, 1:]], dim=2)  # [B,h·w,3C]
        h, w = (side // patch for side in self.backbone.padded(size))
        maps = tokens.mT.reshape(len(tokens), -1, h, w)  # [B,3C,h,w]
        width = normed.shape[2]
        depth = self.backbone.enlarged(self.depth(maps[:, : 2 * width])[:, None], size)[:, 0]
        logits = self.cityscapes(self.class_head["conv_seg"](self.class_head["bn"](maps[:, 2 * width :])))
        return scaled_by_focal(depth, K, KITTI_FOCAL), self.backbone.enlarged(logits, size)

    def depth(self, features: Tensor) -> Tensor:
        """Return the weighted mean [B,4h,4w] of 256 depths in metres from features [B,2C,h,w]."""
        # The authors interpolate first. Both steps are linear, and the weights of an interpolation add up to 1.
        bins = self.depth_head["conv_depth"](features).float()
        shares = F.interpolate(bins, scale_factor=4, mode="bilinear", align_corners=False).relu() + 0.1  # [B,256,4h,4w]
        depth_m = torch.linspace(MIN_DEPTH_M, MAX_DEPTH_M, BINS, device=bins.device)
        with torch.autocast(bins.device.type, enabled=False):  # a sum of 256 terms is inaccurate in half precision
            return torch.einsum("bnhw,n->bhw", shares, depth_m) / shares.sum(dim=1)


def create_dinov2(settings: Any) -> tuple[dict[str, Any], nn.Module]:
    """Return architecture and network of section ``encoder``, which names the heads' files. Raises InputError."""
    folder, description, sources = describe(settings.model)
    architecture = {"backbone": "dinov2", "model": description, "sources": sources}
    with loading(settings.model):
        if description["config"]["model_type"] != "dinov2":
            raise InputError("expected a network of type dinov2")
        network = DinoV2(architecture, folder)
    for head, file in ((network.depth_head, settings.depth), (network.class_head, settings.classes)):
        with loading(file):
            head.load_state_dict(read_head(Path(file)))
    return architecture, network


def read_head(path: Path) -> dict[str, Tensor]:
    """Return the tensors of a head's file, which stand beside numbers of its training."""
    # Pickled under numpy 1's name of the type, or its present one.
    numbers: list[Any] = [(scalar, "numpy.core.multiarray.scalar"), scalar, np.dtype]
    numbers += [np.dtypes.Float64DType, np.dtypes.Int64DType]
    with torch.serialization.safe_globals(numbers):
        state = torch.load(path, weights_only=True, map_location="cpu")["state_dict"]
    return {name.removeprefix("decode_head."): tensor for name, tensor in state.items()}
