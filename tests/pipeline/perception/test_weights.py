"""Files of weights, and the training targets of heads."""

import hashlib
from pathlib import Path

import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.perception import perceive
from pipeline.perception.weights import (
    Source,
    Supervision,
    check_available,
    choose,
    fetch,
    load_weights,
    read_published,
    supervision,
)
from pipeline.settings.encoder import WeightFile, Weights

CONTENT = b"some weights"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture(autouse=True)
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def published(sha256: str | None = SHA256, **other: str) -> WeightFile:
    """Return a file with a URL; without `other`, it exists."""
    path = Path("published/net.pth").resolve()
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(CONTENT)
    return WeightFile.model_validate({"url": path.as_uri(), "sha256": sha256, **other})


def test_a_file_is_downloaded_once_verified_and_nothing_is_written_to_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    file = published()
    assert fetch(file) == SHA256
    Path("published/net.pth").unlink()
    assert fetch(file) == SHA256
    assert [path.name for path in Path("weights").iterdir()] == ["net.pth"]
    assert capsys.readouterr().err == ""


def test_a_path_is_verified_if_it_has_a_hash() -> None:
    published()
    assert fetch(WeightFile(url="published/net.pth")) == SHA256
    with pytest.raises(InputError, match=f"SHA-256 is {SHA256}, expected 0000") as raised:
        fetch(WeightFile(url="published/net.pth", sha256="0" * 64))
    assert "Delete" in raised.value.fix


def test_a_download_with_another_hash_leaves_nothing() -> None:
    with pytest.raises(InputError, match="cannot download file:") as raised:
        fetch(published("0" * 64))
    assert "curl --create-dirs -L -o weights/net.pth" in raised.value.fix
    assert list(Path("weights").iterdir()) == []


def test_the_encoder_of_real_streets_is_made_by_make() -> None:
    with pytest.raises(InputError, match="file is missing") as raised:
        check_available(Weights.model_validate("weights/street/encoder.pt"))
    assert raised.value.fix == "Make it: make street"


def test_a_folder_is_no_file_of_weights() -> None:
    Path("net.pth").mkdir()
    for check in (check_available, lambda weights: load_weights(None, "small", weights)):
        with pytest.raises(InputError, match=r"^net\.pth: "):
            check(Weights.model_validate("net.pth"))


STATE = {"conv.weight": torch.arange(3.0)}


@pytest.mark.parametrize(
    "content",
    [
        STATE,
        {"state_dict": STATE, "meta": {"epoch": 3}},
        STATE | {"height": 192, "use_stereo": True},  # as Monodepth2's
    ],
)
def test_published_tensors_are_found_alone_or_beside_other_data(content: object) -> None:
    torch.save(content, "file.pth")
    assert {name: tensor.tolist() for name, tensor in read_published(Path("file.pth")).items()} == {
        "conv.weight": [0, 1, 2]
    }


class Code:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("never",)


@pytest.mark.parametrize(
    "content",
    [Code(), 3, {**STATE, "b": "two"}, {}],
)
def test_other_published_files_are_refused(content: object) -> None:
    torch.save(content, "file.pth")
    with pytest.raises(InputError) as raised:
        read_published(Path("file.pth"))
    assert raised.value.where == "file.pth"


def test_a_part_is_filled_from_its_file_and_only_if_all_tensors_match() -> None:
    torch.manual_seed(0)
    state = UnifiedEncoder("espnetv2-s1").backbone.state_dict()
    torch.save(state, "city.pth")
    model = UnifiedEncoder("espnetv2-s1")
    before = {name: tensor.clone() for name, tensor in model.depth_head.state_dict().items()}
    files = Weights.model_validate({"backbone": "city.pth"})
    assert load_weights(model, "espnetv2-s1", files) == [Source("backbone", "city.pth", file_hash(Path("city.pth")))]
    assert all(torch.equal(tensor, state[name]) for name, tensor in model.backbone.state_dict().items())
    assert all(torch.equal(tensor, before[name]) for name, tensor in model.depth_head.state_dict().items())
    torch.save(state | {"extra": torch.zeros(1)}, "bad.pth")
    with pytest.raises(InputError, match=r'Unexpected key.* "extra"') as raised:
        load_weights(model, "espnetv2-s1", Weights.model_validate({"backbone": "bad.pth"}))
    assert (raised.value.where, raised.value.fix) == ("backbone: bad.pth", "Name another file")
    with pytest.raises(InputError) as raised:
        load_weights(model, "espnetv2-s1", Weights.model_validate("city.pth"))
    assert "weights: {backbone: FILE}" in raised.value.fix


def test_a_checkpoint_fills_all_parts_of_the_same_backbone() -> None:
    torch.manual_seed(1)
    fitted, model = UnifiedEncoder("small"), UnifiedEncoder("small")
    perceive.save(Path(), "small", fitted.state_dict())
    files = Weights.model_validate("encoder.pt")
    assert load_weights(model, "small", files) == [Source("all", "encoder.pt", file_hash(Path("encoder.pt")))]
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), fitted.parameters(), strict=True))
    with pytest.raises(InputError, match="backbone is 'small', expected 'swin-t'"):
        load_weights(model, "swin-t", files)
    assert load_weights(model, "small", None) == []


SMALL, ESPNET = (UnifiedEncoder(name) for name in ("small", "espnetv2-s1"))
ALL = {"depth", "lidar", "cls"}
CHECKPOINT = Weights.model_validate("encoder.pt")


def files(*parts: str) -> Weights:
    return Weights.model_validate(dict.fromkeys(parts, "a.pth"))


@pytest.mark.parametrize(
    ("head", "model", "weights", "ground_truth", "teacher", "expected"),
    [
        ("depth_head", SMALL, None, ALL, False, Supervision.DENSE_DEPTH),
        ("depth_head", SMALL, None, {"lidar", "cls"}, False, Supervision.LIDAR),
        ("depth_head", SMALL, CHECKPOINT, ALL, False, Supervision.DENSE_DEPTH),  # the fit starts from a checkpoint
        ("depth_head", SMALL, files("depth_head"), ALL, False, Supervision.FILE),  # a published head is not changed
        ("depth_head", ESPNET, None, {"cls"}, False, Supervision.FLAT_GROUND),
        ("class_head", SMALL, None, ALL, True, Supervision.CLASS_LABELS),
        ("class_head", SMALL, None, {"lidar"}, True, Supervision.TEACHER),
        ("class_head", SMALL, files("class_head"), {"lidar"}, True, Supervision.TEACHER),  # it starts from the file
        ("class_head", SMALL, files("class_head"), ALL, True, Supervision.CLASS_LABELS),
        ("class_head", ESPNET, files("backbone"), {"lidar"}, False, Supervision.FILE),  # its classes are the backbone's
        ("depth_head", SMALL, None, {"cls"}, False, "no depth_head"),
        ("class_head", SMALL, None, {"depth"}, False, "no class_head"),
    ],
)
def test_each_head_has_one_target_or_is_refused(
    head: str,
    model: UnifiedEncoder,
    weights: Weights | None,
    ground_truth: set[str],
    teacher: bool,
    expected: Supervision | str,
) -> None:
    if isinstance(expected, Supervision):
        assert supervision(head, model, weights, ground_truth, teacher=teacher) is expected
        assert expected.fits == (expected not in (Supervision.FILE, Supervision.FLAT_GROUND))
        return
    with pytest.raises(InputError, match=expected) as raised:
        supervision(head, model, weights, ground_truth, teacher=teacher)
    assert {"depth_head": "LiDAR", "class_head": "encoder.teacher"}[head] in raised.value.fix


def test_only_parts_with_a_target_have_gradients(capsys: pytest.CaptureFixture[str]) -> None:
    model = UnifiedEncoder("small")
    targets = choose(model, CHECKPOINT, {"depth"}, teacher=False, frozen=False)
    assert targets == {"depth_head": Supervision.DENSE_DEPTH, "class_head": Supervision.FILE}
    fitted = {name for name, part in model.named_children() if any(p.requires_grad for p in part.parameters())}
    assert fitted == {"backbone", "depth_head"}
    assert "class_head" in capsys.readouterr().out  # its backbone changes
    choose(model, CHECKPOINT, {"depth"}, teacher=False, frozen=True)
    assert not any(parameter.requires_grad for parameter in model.backbone.parameters())
    assert capsys.readouterr().out == ""
    with pytest.raises(InputError, match="nothing is left to fit"):
        choose(model, files("backbone", "depth_head", "class_head"), {"depth"}, teacher=False, frozen=True)
