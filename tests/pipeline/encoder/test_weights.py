import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.encoder.weights import Source, fill, read_published, read_weights, write_weights
from pipeline.fitting.checkpoint import load_state

MEND = "Mend it so."


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    torch.manual_seed(1)
    write_weights(tmp_path / "encoder.pt", "small", UnifiedEncoder("small").state_dict())
    return tmp_path / "encoder.pt"


def test_written_weights_come_back_bit_by_bit_and_the_file_is_deterministic(checkpoint: Path, tmp_path: Path) -> None:
    weights = read_weights(checkpoint, MEND)
    assert weights.backbone == "small"
    model = UnifiedEncoder("small")
    load_state(model, weights.state, checkpoint, MEND)
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, weights.state[name]), name
    (tmp_path / "other").mkdir()
    write_weights(tmp_path / "other" / "encoder.pt", "small", model.state_dict())
    assert (tmp_path / "other" / "encoder.pt").read_bytes() == checkpoint.read_bytes()


def test_read_refuses_other_content(checkpoint: Path, tmp_path: Path) -> None:
    content = checkpoint.read_bytes()
    checkpoint.write_bytes(content[: len(content) // 3])
    with pytest.raises(InputError, match=r"encoder\.pt is cut short, .* Mend it so\."):
        read_weights(checkpoint, MEND)
    torch.save({"conv.weight": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(InputError, match="no checkpoint of this project's unified encoder"):
        read_weights(tmp_path / "other.pt", MEND)
    net = {"conv.weight": torch.zeros(3)}
    for rest in ({}, {"net": net}, {"backbone": "small"}, {"backbone": "small", "net": {0: net["conv.weight"]}}):
        torch.save({"kind": "unified encoder", **rest}, tmp_path / "other.pt")
        with pytest.raises(InputError, match=r"lacks the backbone's name or the network's tensors\. Mend it so\."):
            read_weights(tmp_path / "other.pt", MEND)


@pytest.mark.parametrize("wrapper", [None, "state_dict", "model"])
def test_published_tensors_are_found_alone_or_beside_settings(tmp_path: Path, wrapper: str | None) -> None:
    state = {"conv.weight": torch.arange(3.0)}
    torch.save({wrapper: state, "meta": {"epoch": 3}} if wrapper else state, tmp_path / "file.pth")
    assert torch.equal(read_published(tmp_path / "file.pth", MEND)["conv.weight"], state["conv.weight"])


def test_numbers_as_numpy_1_wrote_them_do_not_hinder(tmp_path: Path) -> None:
    """DINOv2's depth heads hold such, in what their training left beside the tensors."""
    meta = {"abs_rel": np.float64(0.08), "step": np.int64(38400)}
    torch.save({"state_dict": {"conv.weight": torch.arange(3.0)}, "meta": meta}, tmp_path / "new.pth")
    with zipfile.ZipFile(tmp_path / "new.pth") as new, zipfile.ZipFile(tmp_path / "old.pth", "w") as old:
        for item in new.infolist():
            old.writestr(item, new.read(item).replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    assert b"numpy.core.multiarray" in (tmp_path / "old.pth").read_bytes()
    for name in ("new.pth", "old.pth"):
        assert read_published(tmp_path / name, MEND)["conv.weight"].tolist() == [0, 1, 2]


def test_published_files_that_are_none_are_refused(tmp_path: Path) -> None:
    class Code:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return print, ("never",)

    contents = {
        "code": Code(),
        "number": 3,
        "tensor": torch.zeros(1),
        "mixed": {"a": torch.zeros(1), "b": 2},
        "numbered": {0: torch.zeros(1)},
        "wrapped tensor": {"model": torch.zeros(2), "epoch": 3},
        "empty": {},
    }
    for name, content in contents.items():
        torch.save(content, tmp_path / name)
        with pytest.raises(InputError, match=r"(plain state dict|plain values).* Mend it so\.") as caught:
            read_published(tmp_path / name, MEND)
        assert "\n" not in str(caught.value)


def test_parts_are_filled_from_their_own_files_and_strictly(tmp_path: Path) -> None:
    torch.manual_seed(0)
    published = UnifiedEncoder("espnetv2-s1").backbone.state_dict()
    torch.save(published, tmp_path / "city.pth")
    model = UnifiedEncoder("espnetv2-s1")
    before = {name: tensor.clone() for name, tensor in model.depth_head.state_dict().items()}
    sources = fill(model, "espnetv2-s1", {"backbone": str(tmp_path / "city.pth")}, "encoder.weights")
    assert sources == [Source("backbone", str(tmp_path / "city.pth"), file_hash(tmp_path / "city.pth"))]
    assert all(torch.equal(tensor, published[name]) for name, tensor in model.backbone.state_dict().items())
    assert all(torch.equal(tensor, before[name]) for name, tensor in model.depth_head.state_dict().items())

    faults = {
        "lacks bu_br_l2.0.bias": {name: t for name, t in published.items() if name != "bu_br_l2.0.bias"},
        "has extra, which the network has not": published | {"extra": torch.zeros(1)},
        r"has bu_br_l2.0.bias of shape \[3\], the network \[64\]": published | {"bu_br_l2.0.bias": torch.zeros(3)},
    }
    for message, state in faults.items():
        torch.save(state, tmp_path / "bad.pth")
        with pytest.raises(InputError, match=message):
            fill(model, "espnetv2-s1", {"backbone": str(tmp_path / "bad.pth")}, "encoder.weights")
    with pytest.raises(InputError, match="a published file is named by part"):
        fill(model, "espnetv2-s1", str(tmp_path / "city.pth"), "encoder.weights")
