"""What is exported says what the network says, on real frames; what does not is not written."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from pipeline.base.errors import InputError
from pipeline.live.export import programs
from pipeline.live.export.export import export
from pipeline.train import frames, windows
from tests.pipeline.live.export import untrained

pytestmark = pytest.mark.slow
DRIVE = "2026_01_01_drive_0001"
MODELS: list[dict[str, Any]] = [
    {"spatial": "gnn", "temporal": "ncp", "equivariant": True, "motion": "visual"},
    {"spatial": "edgeconv", "temporal": "ncp", "cell": "cfc"},
    {"spatial": "gatv2", "temporal": "ncp", "cell": "eq4"},
    {"spatial": "pointnet2", "equivariant": True},
    {"spatial": "cnn"},
]


@pytest.fixture
def without_onnx(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "find_spec", lambda name: None)


@pytest.mark.parametrize("settings", MODELS, ids=lambda settings: settings["spatial"])
def test_each_network_is_exported_and_verified(tmp_path: Path, settings: dict[str, Any]) -> None:
    pytest.importorskip("onnxruntime", reason="pip install '.[onnx]'")
    model = untrained.model(tmp_path, **settings)
    content = export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    assert content["without"] == {}
    files = [f"{part}.{kind}" for kind in ("pt2", "onnx") for part in ("spatial", "recurrent")]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([*files, "export.json"])
    assert set(content["verified"]["largest_difference"]) > set(files)
    assert content["verified"]["windows"] == 8
    assert json.loads((tmp_path / "out/export.json").read_text()) == json.loads(json.dumps(content))


@pytest.mark.usefixtures("without_onnx")
def test_a_reader_of_export_json_gets_the_angles(tmp_path: Path) -> None:
    """Nothing of this project but the arrays of a frame, which are another's than those it was traced with."""
    model = untrained.model(tmp_path, "gnn", "ncp", equivariant=True, motion="visual")
    export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    said = json.loads((tmp_path / "out/export.json").read_text())
    spatial, recurrent = (torch.export.load(tmp_path / f"out/{part}.pt2").module() for part in said["parts"])
    with frames.open_graphs(tmp_path / f"graphs/semantic/{DRIVE}.h5") as graphs:
        expected = model.predict(graphs)
        timeline = windows.Timeline.of(graphs, "visual", model.target.car)
        assert timeline.motion is not None
        seen = [graphs.read(row, row + 1) for row in range(len(graphs.frame))]
    names = [each["name"] for each in said["parts"]["spatial"]["inputs"]]
    features = torch.cat([spatial(*(torch.from_numpy(frame[name]) for name in names)) for frame in seen])
    for last in (4, 11):
        rows = slice(last + 1 - said["window"], last + 1)
        dt_s, motion = (torch.from_numpy(of[rows])[None] for of in (timeline.dt_s, timeline.motion))
        answer = recurrent(features[rows][None], dt_s, motion)
        angle = timeline.motion[last, 0] + said["std_rad"] * float(answer[0])
        assert angle == pytest.approx(expected[last], abs=1e-6)
    assert len({frame["indices"].shape for frame in seen}) > 1


@pytest.mark.usefixtures("without_onnx")
def test_an_export_is_there_when_it_is_verified_and_replaces_only_its_own_kind(tmp_path: Path) -> None:
    model = untrained.model(tmp_path)
    graphs, out = tmp_path / "graphs/semantic", tmp_path / "out"
    with pytest.raises(InputError, match=r"spatial\.pt2 of model net differs .* tolerance of 0: nothing is written"):
        export(model, graphs, out, 0.0)
    assert not out.exists()
    content = export(model, graphs, out, 1e-5)
    assert content["without"]["spatial.onnx"] == "onnx, onnxscript, onnxruntime not installed: pip install '.[onnx]'"
    assert not list(out.glob("*.onnx"))
    export(model, graphs, out, 1e-5)
    (out / "export.json").rename(tmp_path / "export.json")
    with pytest.raises(InputError, match=r"out is there, and no earlier export: name a new folder by --out"):
        export(model, graphs, out, 1e-5)
    assert (out / "spatial.pt2").is_file()
    with pytest.raises(InputError, match=r"export\.json is there, and no earlier export"):
        export(model, graphs, tmp_path / "export.json", 1e-5)


def test_what_onnx_cannot_say_stays_a_pt2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime", reason="pip install '.[onnx]'")

    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("Failed to convert\nlong advice") from ValueError("aten.wonder is unknown\n\nmore")

    monkeypatch.setattr(torch.onnx, "export", refuse)
    content = export(untrained.model(tmp_path), tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    assert content["without"] == dict.fromkeys(("spatial.onnx", "recurrent.onnx"), "aten.wonder is unknown")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["export.json", "recurrent.pt2", "spatial.pt2"]


class Stubborn(nn.Module):
    """A network of somebody's own that decides by what it sees."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(3, 8))

    def forward(self, batch: Any) -> Tensor:
        if float(batch.xyz.sum()) > 0:
            return torch.zeros(batch.frames, 8)
        return torch.ones(batch.frames, 8)


@pytest.mark.usefixtures("without_onnx")
def test_a_network_that_cannot_be_traced_is_named(tmp_path: Path) -> None:
    model = untrained.model(tmp_path)
    model.net.spatial = Stubborn()
    with pytest.raises(InputError, match=r"model net, spatial: gnn: the spatial part cannot be exported: .+"):
        export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("without_onnx")
def test_no_window_to_verify_by_is_an_error(tmp_path: Path) -> None:
    model = untrained.model(tmp_path, window=13)
    with pytest.raises(InputError, match="holds no window of 13 consecutive frames to verify the export by"):
        export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    untrained.model(tmp_path / "other", "cnn")
    with pytest.raises(InputError, match=r"model net expects kNN graphs, but .* holds images of 32 x 48 pixels"):
        export(model, tmp_path / "other/graphs/semantic", tmp_path / "out", 1e-5)
