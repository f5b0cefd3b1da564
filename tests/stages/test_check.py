"""Stage check: faults of params.yaml and of models are one line with their key."""

import re
from functools import reduce
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import yaml

from models.steering.core import options
from models.steering.spatial import blind
from pipeline.base.errors import InputError
from pipeline.check import check_model
from pipeline.train.quantities import angle
from stages import check, preset
from tests.presets import NAMES

ROOT = Path(__file__).resolve().parents[2]
MODEL = "models.sa-gnn-ncp"
PYG = {"input": "semantic", "spatial": "pyg", "temporal": "lstm", "semantics": 1.0}
GNN = PYG | {"spatial": "gnn"}
FIT = {"epochs": 0, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
PAIR = {"backbone": "pair", "depth": "a/b", "classes": "c/d", "focal_by_width": 0.6, **FIT}


def changed(where: str, value: Any) -> dict[str, Any]:
    """Return the content of params.yaml with preset table2, and one value changed or added."""
    content = yaml.safe_load(preset.to_yaml(preset.merge_preset("table2"), "a test"))
    *path, key = where.split(".")
    reduce(dict.__getitem__, path, content)[key] = value
    return content


def run(folder: Path, content: dict[str, Any]) -> Path:
    (folder / "params.yaml").write_text(yaml.safe_dump(content))
    return check.main(folder / "params.yaml")


@pytest.mark.parametrize("name", [None, *NAMES])
def test_the_projects_own_files_are_valid(name, tmp_path, monkeypatch, capsys):
    """Weights of real streets may be missing: check does not download them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").symlink_to(ROOT / "models")
    text = (ROOT / "params.yaml").read_text()
    if name:
        text = preset.to_yaml(preset.merge_preset(name), "a test")
    run(tmp_path, yaml.safe_load(text))
    assert re.fullmatch(r"\d+ models checked\n", capsys.readouterr().out)


def test_measured_motion_is_not_both_input_and_label(tmp_path):
    """The label of a model with a horizon, or of a path, is driven after the input."""
    content = changed("labels.source", "motion")
    net = content["models"]["sa-gnn-ncp"] | {"motion": "visual"}
    content["models"] = {"net": net}
    problem = r"models\.net: motion: visual with labels\.source: motion at"
    with pytest.raises(InputError, match=problem) as raised:
        run(tmp_path, content)
    assert "motion: none" in raised.value.fix
    for change in ({"horizon": 10}, {"predict": "path"}):
        content["models"] = {"net": net | change}
        run(tmp_path, content)
    content["labels"]["ahead_m"] = []
    with pytest.raises(InputError, match=r"models\.net: predict: path needs labels\.ahead_m"):
        run(tmp_path, content)


def test_weights_are_looked_for_where_stage_encoder_will_run(tmp_path):
    """DVC takes or fetches an encoder of the settings in dvc.lock: its weights may be missing."""
    content = changed("encoder.weights", "no.pt")
    lock = {"stages": {"encoder": {"params": {"params.yaml": {"encoder": content["encoder"]}}}}}
    (tmp_path / "dvc.lock").write_text(yaml.safe_dump(lock))
    run(tmp_path, content)
    content["encoder"]["seed"] = 1
    with pytest.raises(InputError, match=r"weights: no.pt: file is missing"):
        run(tmp_path, content)
    (tmp_path / "dvc.lock").write_text("stages:\n<<<<<<< HEAD\n  encoder: {}\n")
    with pytest.raises(InputError, match=rf"^{tmp_path}/dvc\.lock:3: invalid YAML"):
        run(tmp_path, content)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (f"{MODEL}.input", "semantc", "input: unknown variant 'semantc': did you mean semantic"),
        (f"{MODEL}.spatial", "cnnn", "spatial.*cnnn.*cnn"),
        (
            "models.regression",
            {"input": "image", "spatial": "cnn", "temporal": "ncp"},
            "models: .*regression is the name of a baseline, or of a line in pictures",
        ),
        (
            "ingest.lidar",
            False,
            "models.gnn-lstm: input = 'lidar-50k' needs scans, but ingest.lidar is false",
        ),
        ("clouds.columns", ["intensty"], "clouds.columns: unknown column 'intensty': did you mean"),
        ("clouds.columns", ["intensity", "intensity"], "clouds.columns: names a column twice"),
        ("graphs.semantic.columns", ["intensity"], "clouds/pseudo has no column 'intensity'"),
        ("graphs.image.columns", ["intensity"], "graphs.image: columns does not apply to images"),
        (
            "graphs.lidar.columns",
            ["intensity"],
            "graphs.lidar has column 'intensity', but the clouds lack it. Add it to clouds.columns",
        ),
        (
            "graphs.semantic.points",
            70000,
            "graphs.semantic.points = 70000 is above clouds.max_points = 12000. Raise",
        ),
        (f"{MODEL}.input", "image", "spatial.*gnn.*images"),
        (
            MODEL,
            {
                "input": "semantic",
                "spatial": "gnn",
                "temporal": "ncp",
                "semantics": 1.0,
                "window": 1,
                "batch_spans": 1,
            },
            "make steps of a single frame, which has no variance. Set batch_spans to 2",
        ),
        ("models.cnn-ncp.input", "semantic", "spatial.*cnn.*expects images"),
        (
            f"{MODEL}.input",
            "lidar-pointnet2",
            "spatial = 'gnn' reads edges, but graphs.lidar-pointnet2 has none. Set graphs.lid",
        ),
        (
            "models.pointnet2-ncp.centres",
            [64],
            "pointnet2-ncp: centres, radius_m and neighbours need one number per level each",
        ),
        ("models.cnn-ncp.semantic", 1.0, "unknown key 'semantic' for spatial = cnn"),
        ("graphs.lidar.points", None, "graphs.lidar: points is missing: the number of points"),
        ("graphs.image.k", 6, r"graphs.image: k does not apply to images \(source: ingest\)"),
        (f"{MODEL}.wiring", {"comand": 5}, "wiring.comand"),
        (
            MODEL,
            {"input": "semantic", "spatial": "gnn", "temporal": "lstm"},
            "semantics is missing: weight of the cl",
        ),
        (MODEL, GNN | {"predict": "path", "horizon": 10}, "predict: path has no horizon"),
        (
            MODEL,
            PYG | {"layer": "GATv2"},
            "no layer 'GATv2' that takes x, edge_index: did you mean GATv2Conv",
        ),
        (
            MODEL,
            PYG | {"layer": "RGCNConv"},
            "models.sa-gnn-ncp: layer RGCNConv {}: .*num_relations",
        ),
        (
            MODEL,
            PYG | {"layer": "APPNP", "layer_options": {"K": 25, "alpha": 0.1}},
            "APPNP .*'in_channels'",
        ),
        (
            MODEL,
            PYG | {"layer": "GCNConv", "layer_options": {"cached": True}},
            "layer_options.cached: .* Remove it",
        ),
        (
            MODEL,
            PYG | {"layer": "GATConv", "layer_options": {"edge_dim": 3}},
            "edge_dim: .* without features",
        ),
        (
            MODEL,
            PYG | {"layer": "SAGEConv", "layer_options": {"aggr": "lstm"}},
            "depends on the other frames of its batch",
        ),
        (
            f"{MODEL}.wiring",
            {"command": 5},
            "sa-gnn-ncp: wiring.motor_fanin = 6, expected at most command = 5",
        ),
        (MODEL, PYG, "layer is missing: a layer of torch_geometric.nn"),
        (
            "encoder",
            {"backbone": "precomputed", "weights": "pngs", **FIT},
            "folder has no PNG files",
        ),
        ("encoder", {"backbone": "precomputed", **FIT}, "folder of PNG files"),
        ("encoder", {"backbone": "street", **FIT, "epochs": 1}, "street is not fitted"),
        (
            "encoder",
            {"backbone": "pair", "depth": "a/b", **FIT},
            "pair needs classes and focal_by_width, or an enc",
        ),
        (
            "encoder",
            PAIR | {"depth": "some/where/else"},
            "depth: 'some/where/else' is not a folder with a config.json",
        ),
        ("model", {}, "model.*did you mean models"),
        ("labels.wheelbase_m", 2700, "wheelbase_m: .*less than or equal to 20 .got 2700"),
        ("ingest.drives.test", ["0001"], "expected a drive's name, such as 2011_09_26_drive_0052"),
        ("ingest.drives.test", ["2026_01_04_drive_0010..0008"], "expected letters"),
        ("train.learning_rate", True, "valid number"),
        ("train.seeds", [0, 1, 0], r"train.seeds: expected each seed once .got \[0, 1, 0"),
        # misspelt, so missing
        ("clouds", {"max_point": 1, "max_depth_m": 80.0}, "did you mean max_points"),
    ],
)
def test_a_fault_is_one_line_with_its_key(tmp_path, where, value, message):
    with pytest.raises(InputError, match=message) as raised:
        run(tmp_path, changed(where, value))
    assert str(raised.value).startswith(str(tmp_path / "params.yaml"))
    assert "\n" not in str(raised.value)


def test_a_faulty_quantity_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(angle.Target, "measured", lambda self, angle_rad: angle_rad)
    problem = r"params.yaml: models\.[\w-]+: predict: angle: measured returns the shape"
    with pytest.raises(InputError, match=problem):
        run(tmp_path, yaml.safe_load((ROOT / "params.yaml").read_text()))


@pytest.mark.parametrize(
    ("file", "watched"),
    [
        ("spatial/gnn.json", "gnn.json"),
        ("temporal/lstm/layers.py", "lstm/layers.py"),
        ("spatial/table.npy", "NETWORK/table.npy, where NETWORK is the one that reads it"),
        ("spatial/gnn.py~", None),
        ("spatial/__pycache__/gnn.pyc", None),
    ],
)
def test_files_beside_a_network_that_dvc_would_not_watch_are_refused(
    tmp_path, monkeypatch, file, watched
):
    folder = tmp_path / "models/steering"
    for path in (folder / "spatial/gnn.py", folder / "temporal/lstm.py", folder / file):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    monkeypatch.setattr(check_model, "ROOT", tmp_path)
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    if watched is None:
        run(tmp_path, content)
        return
    with pytest.raises(InputError) as raised:
        run(tmp_path, content)
    problem = "DVC would not notice its changes. Move it to models/steering/weights/"
    assert str(raised.value) == f"models/steering/{file}: {problem}{watched}"


@pytest.mark.parametrize(
    ("part", "name", "error"),
    [(options.importlib, "import_module", ImportError), (blind.Options, "build", ValueError)],
)
def test_a_bug_of_a_network_is_no_fault_of_the_settings(tmp_path, monkeypatch, part, name, error):
    content = changed(
        "models", {"net": {"input": "semantic", "spatial": "blind", "temporal": "lstm"}}
    )
    monkeypatch.setattr(part, name, Mock(side_effect=ValueError("boom")))
    with pytest.raises(error, match="boom") as raised:
        run(tmp_path, content)
    assert raised.type is error
