"""Folders with tiny random networks of Hugging Face, as a hub has them."""

import json
from pathlib import Path

import numpy as np
import torch
import transformers

LABELS = ("road", "Tree", "sky", "zebra")
DINOV2 = {"hidden_size": 24, "num_hidden_layers": 4, "num_attention_heads": 2, "image_size": 70, "patch_size": 14}
SEGFORMER = {"hidden_sizes": [8, 8, 16, 16], "depths": [1] * 4, "num_attention_heads": [1, 1, 2, 2]}


def write(folder: Path) -> Path:
    """Write the folders depth, relative, glpn, classes, swin and dinov2, and two heads of DINOv2. Returns `folder`."""
    torch.manual_seed(0)
    dinov2 = transformers.Dinov2Config(**DINOV2)
    backbone = {**DINOV2, "out_indices": [1, 2, 3, 4], "apply_layernorm": True, "reshape_hidden_states": False}
    fusion = {"reassemble_hidden_size": 24, "neck_hidden_sizes": [8, 8, 16, 16], "fusion_hidden_size": 8}
    networks = {"dinov2": transformers.Dinov2Model(dinov2)}
    for name, kind in {"depth": "metric", "relative": "relative"}.items():
        config = transformers.DepthAnythingConfig(
            backbone_config=transformers.Dinov2Config(**backbone), depth_estimation_type=kind, max_depth=80, **fusion
        )
        networks[name] = transformers.DepthAnythingForDepthEstimation(config)
    networks["glpn"] = transformers.GLPNForDepthEstimation(transformers.GLPNConfig(**SEGFORMER, decoder_hidden_size=16))
    config = transformers.SegformerConfig(**SEGFORMER, decoder_hidden_size=16, id2label=dict(enumerate(LABELS)))
    networks["classes"] = transformers.SegformerForSemanticSegmentation(config)
    swin = transformers.SwinConfig(embed_dim=12, depths=[1] * 4, num_heads=[1, 2, 3, 4], drop_path_rate=0.0)
    networks["swin"] = transformers.SwinModel(swin)
    for name, network in networks.items():
        network.save_pretrained(folder / name)
    images = {"do_normalize": True, "image_mean": [0.4, 0.5, 0.6], "image_std": [0.1, 0.2, 0.3]}
    (folder / "depth/preprocessor_config.json").write_text(json.dumps(images))
    heads = {
        "depth": {"conv_depth.weight": (256, 48, 1, 1), "conv_depth.bias": (256,)},
        "classes": {
            "bn.weight": (24,), "bn.bias": (24,), "bn.running_mean": (24,), "bn.running_var": (24,),
            "bn.num_batches_tracked": (), "conv_seg.weight": (150, 24, 1, 1), "conv_seg.bias": (150,),
        },
    }  # fmt: skip
    for name, shapes in heads.items():
        state = {f"decode_head.{tensor}": torch.rand(shape) for tensor, shape in shapes.items()}
        torch.save({"state_dict": state, "meta": {"iter": 38400, "best": np.float64(0.1)}}, folder / f"{name}.pth")
    return folder
