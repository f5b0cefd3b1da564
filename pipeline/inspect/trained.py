"""What stages encoder, train, evaluate, scores and report leave in their folders: networks and their errors."""

import csv
from collections import Counter
from pathlib import Path
from typing import Any

from pipeline.inspect.reading import damage_told, json_object, mapping, text

Content = dict[str, Any]
_MOST = 1e300  # of a figure; JSON may hold whole numbers that are no float


def model(folder: Path) -> Content:
    """Tell a trained model: its line of params.yaml, size, how it was fitted, and how its curve ended."""
    config = json_object(folder / "config.json")
    splits = mapping(config.get("splits"))
    return {
        "kind": "model",
        "stage": "train",
        "name": config.get("name", folder.name),
        "line": mapping(config.get("model")),
        **{
            key: config.get(key)
            for key in ("parameters", "epochs", "best_epoch", "revision", "seeds", "target")
        },
        "drives": dict(Counter(str(split) for split in splits.values())),
        "made_of": list(splits),
        "settings": {"train": mapping(config.get("train"))},
        "curve_end": _last_row(folder / "curve.csv"),
        "networks": sorted(str(best.parent.relative_to(folder)) for best in folder.rglob("best.pt")),
    }


def encoder(folder: Path) -> Content:
    """Tell the unified encoder: its settings, and to how many drives it was fitted."""
    config = json_object(folder / "config.json")
    per_drive = mapping(config.pop("frames_per_drive", None))
    return {
        "kind": "encoder",
        "stage": "encoder",
        "settings": {"encoder": config},
        "drives": len(per_drive),
        "made_of": list(per_drive),
        "curve_end": _last_row(folder / "curve.csv"),
    }


def evaluation(folder: Path) -> Content:
    """Tell a model's errors: the headline of its metrics.json."""
    metrics = json_object(folder / "metrics.json")
    return {
        "kind": "evaluation",
        "stage": "evaluate",
        "name": metrics.get("model", folder.name),
        "line": mapping(metrics.get("line")),
        "errors": {split: _headline(mapping(metrics.get(split))) for split in ("train", "val", "test")},
        "made_of": _names(metrics.get("drives")),
        **{key: metrics.get(key) for key in ("parameters", "points_per_frame", "edges_per_frame", "seeds")},
    }


def _names(drives: Any) -> list[str]:
    lists = (names for names in mapping(drives).values() if isinstance(names, list))
    return [str(name) for names in lists for name in names]


def _headline(split: Content) -> Content:
    keys = ("frames", "nmse", "nmse_ci95", "rmse_deg", "mae_deg", "drift_m_per_100m")
    baselines = {name: mapping(value).get("nmse") for name, value in mapping(split.get("baselines")).items()}
    return {key: split[key] for key in keys if key in split} | ({"baselines_nmse": baselines} if baselines else {})


def figures(folder: Path) -> Content:
    """Tell another metrics.json, of scores or the report: its figures that are plain numbers."""
    return {"kind": "figures", "figures": _numbers(json_object(folder / "metrics.json"))}


def _numbers(tree: Content, prefix: str = "", depth: int = 0) -> Content:
    result: Content = {}
    for key, value in tree.items():
        if isinstance(value, dict) and depth < 3:
            result |= _numbers(value, f"{prefix}{key}.", depth + 1)
        elif isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _MOST:
            result[f"{prefix}{key}"] = value
    return result


def _last_row(path: Path) -> Content:
    """Return the last line of a curve, by its columns; nothing where there is no curve."""
    if not path.is_file():
        return {}
    with damage_told(path):
        rows = list(csv.DictReader(text(path).splitlines()))
    return {str(key): value for key, value in rows[-1].items()} if rows else {}
