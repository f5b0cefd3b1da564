"""DINOv2 compared with the authors' names and formulas in plain torch, on random weights."""

import copy
import math
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from models.encoder.backbones import Parts
from models.encoder.backbones.dinov2 import SIZES, padding
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.perception.weights import load_weights
from pipeline.settings.encoder import Weights

WIDTH, LAYERS, HEADS = SIZES["vits14"]
State = dict[str, Tensor]


@pytest.fixture(scope="module")
def backbone_file() -> State:
    """As ``dinov2_vits14_pretrain.pth``."""
    random = _generator()
    state = {
        "cls_token": random(1, 1, WIDTH),
        "pos_embed": random(1, 1 + 37 * 37, WIDTH),
        "mask_token": random(1, WIDTH),
        "patch_embed.proj.weight": random(WIDTH, 3, 14, 14),
        "patch_embed.proj.bias": random(WIDTH),
        "norm.weight": 1 + random(WIDTH),
        "norm.bias": random(WIDTH),
    }
    for block in range(LAYERS):
        shapes = {
            "norm1.weight": (WIDTH,), "norm1.bias": (WIDTH,), "norm2.weight": (WIDTH,), "norm2.bias": (WIDTH,),
            "attn.qkv.weight": (3 * WIDTH, WIDTH), "attn.qkv.bias": (3 * WIDTH,),
            "attn.proj.weight": (WIDTH, WIDTH), "attn.proj.bias": (WIDTH,),
            "ls1.gamma": (WIDTH,), "ls2.gamma": (WIDTH,),
            "mlp.fc1.weight": (4 * WIDTH, WIDTH), "mlp.fc1.bias": (4 * WIDTH,),
            "mlp.fc2.weight": (WIDTH, 4 * WIDTH), "mlp.fc2.bias": (WIDTH,),
        }  # fmt: skip
        for name, shape in shapes.items():
            state[f"blocks.{block}.{name}"] = random(*shape) + (0.3 if "gamma" in name else 0)
    return state


@pytest.fixture(scope="module")
def depth_file() -> State:
    random = _generator()
    return {
        "decode_head.conv_depth.weight": random(256, 2 * WIDTH, 1, 1),
        "decode_head.conv_depth.bias": random(256),
    }


@pytest.fixture(scope="module")
def files(backbone_file: State, depth_file: State, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Files as the authors publish them: the heads are beside data of their training."""
    folder = tmp_path_factory.mktemp("weights")
    meta = {"epoch": 1, "iter": 38400}
    torch.save(backbone_file, folder / "backbone.pth")
    torch.save({"state_dict": depth_file, "meta": meta}, folder / "depth_head.pth")
    return {part: str(folder / f"{part}.pth") for part in ("backbone", "depth_head")}


@pytest.fixture(scope="module")
def parts(files: dict[str, str]) -> Parts:
    model = UnifiedEncoder("dinov2-vits14").eval()
    load_weights(model, "dinov2-vits14", Weights.model_validate(files))
    return Parts(model.backbone, model.depth_head, model.class_head)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(56, 84), (50, 75)])
def test_features_and_depth_equal_the_authors_formulas(
    parts: Parts, backbone_file: State, depth_file: State, size: tuple[int, int]
) -> None:
    image = torch.randn(2, 3, *size, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    rays = torch.zeros(2, 2, *size)
    backbone, depth_head = (copy.deepcopy(part).double() for part in parts[:2])
    backbone_file, depth_file = (
        {name: tensor.double() for name, tensor in file.items()} for file in (backbone_file, depth_file)
    )
    with torch.no_grad():
        tokens = backbone(image, rays)
        depth = depth_head(tokens, rays)

    top, bottom, left, right = padding(torch.Size(size))
    raw, h, w = _vit(backbone_file, F.pad(image, (left, right, top, bottom)))
    torch.testing.assert_close(tokens.patches, raw[:, 1:].mT.reshape(2, WIDTH, h, w), rtol=0, atol=1e-6)

    def whole(x: Tensor) -> Tensor:
        enlarged = F.interpolate(x, (14 * h, 14 * w), mode="bilinear", align_corners=False)
        return enlarged[..., top : top + size[0], left : left + size[1]]

    # Depth as the authors compute it: the class token beside each patch, enlarged four times, then the 1x1 convolution.
    both = torch.cat([raw[:, 1:], raw[:, :1].expand(-1, h * w, -1)], dim=2).mT.reshape(2, 2 * WIDTH, h, w)
    both = F.interpolate(both, (4 * h, 4 * w), mode="bilinear", align_corners=False)
    bins = F.conv2d(both, depth_file["decode_head.conv_depth.weight"], depth_file["decode_head.conv_depth.bias"])
    shares = bins.relu() + 0.1
    expected = (shares * torch.linspace(0.001, 80, 256, dtype=torch.float64)[:, None, None]).sum(1) / shares.sum(1)
    torch.testing.assert_close(depth.double(), whole(expected[:, None])[:, 0], rtol=1e-5, atol=0)


def _generator() -> Any:
    generator = torch.Generator().manual_seed(0)
    return lambda *shape: 0.05 * torch.randn(*shape, generator=generator)


def _vit(state: State, image: Tensor) -> tuple[Tensor, int, int]:
    """The tokens [B,1+h·w,C] after the last block, by the authors' names, and h, w."""
    patches = F.conv2d(image, state["patch_embed.proj.weight"], state["patch_embed.proj.bias"], stride=14)
    h, w = patches.shape[-2:]
    grid = state["pos_embed"][:, 1:].reshape(1, 37, 37, WIDTH).permute(0, 3, 1, 2)
    grid = F.interpolate(grid, (h, w), mode="bicubic", align_corners=False).flatten(2).mT
    x = torch.cat([state["cls_token"].expand(len(image), -1, -1), patches.flatten(2).mT], dim=1)
    x = x + torch.cat([state["pos_embed"][:, :1], grid], dim=1)
    for number in range(LAYERS):
        block = {name.split(".", 2)[2]: t for name, t in state.items() if name.startswith(f"blocks.{number}.")}
        y = F.layer_norm(x, (WIDTH,), block["norm1.weight"], block["norm1.bias"], 1e-6)
        qkv = F.linear(y, block["attn.qkv.weight"], block["attn.qkv.bias"]).unflatten(2, (3, HEADS, -1))
        q, k, v = qkv.permute(2, 0, 3, 1, 4)  # [B,heads,N,C/heads]
        y = ((q @ k.mT / math.sqrt(WIDTH // HEADS)).softmax(-1) @ v).transpose(1, 2).flatten(2)
        x = x + block["ls1.gamma"] * F.linear(y, block["attn.proj.weight"], block["attn.proj.bias"])
        y = F.layer_norm(x, (WIDTH,), block["norm2.weight"], block["norm2.bias"], 1e-6)
        y = F.gelu(F.linear(y, block["mlp.fc1.weight"], block["mlp.fc1.bias"]))
        x = x + block["ls2.gamma"] * F.linear(y, block["mlp.fc2.weight"], block["mlp.fc2.bias"])
    return x, h, w
