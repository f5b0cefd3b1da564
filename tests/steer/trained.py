"""A small sample driven through the whole chain in this process, with four models."""

from contextlib import chdir
from pathlib import Path

import yaml

from pipeline.base.resume import ROOT
from stages import clouds, encoder, evaluate, graphs, ingest, labels, motion, perception, sample, train

TEST = "2026_01_03_drive_0001"
MODELS = {
    "points": {
        "input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 4, "equivariant": True, "motion": "visual",
        "uncertainty": True, "semantics": 0.0,
    },
    "scans": {
        "input": "lidar", "spatial": "gnn", "temporal": "lstm", "window": 3, "motion": "visual", "base": "none",
        "horizon": 2, "semantics": 0.0,
    },
    "images": {"input": "image", "spatial": "cnn", "temporal": "lstm", "window": 2},
    "path": {
        "input": "image", "spatial": "cnn", "temporal": "lstm", "window": 2, "predict": "path", "uncertainty": True,
    },
}  # fmt: skip
VARIANTS = {
    "semantic": {"source": "clouds/pseudo", "points": 200, "k": 4, "keep_inter_class": 0.2},
    "lidar": {
        "source": "clouds/lidar", "points": 200, "k": 4, "crop_m": [-15, -10, 15, 30],
        "accumulate": {"frames": 3},
    },
    "image": {"source": "ingest"},
}  # fmt: skip


def make(folder: Path) -> None:
    """Write params.yaml and data/ to a folder: three drives of a few frames, and MODELS trained on them."""
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["sample"] |= {"image_size": [96, 320], "frames": {"train": 24, "val": 8, "test": 12}}
    params["ingest"] |= {
        "image_size": [96, 320],
        "drives": {"train": ["2026_01_01_drive_0001"], "val": ["2026_01_02_drive_0002"], "test": [TEST]},
    }
    params["encoder"]["weights"] = str(ROOT / params["encoder"]["weights"])
    params["perception"] |= {"reach": 1.1, "depth_scale": "camera_height"}
    params["clouds"] |= {"max_points": 2000}
    params["graphs"], params["models"] = VARIANTS, MODELS
    params["labels"] |= {"ahead_m": [0, 2, 4]}
    params["train"] |= {"epochs": 1}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    with chdir(folder):
        for stage in (sample, ingest, labels, encoder, perception, motion, clouds):
            stage.main()
        for variant in VARIANTS:
            graphs.main(variant)
        for model in MODELS:
            train.main(model)
            evaluate.main(model)
