from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.encoder import perceive
from pipeline.encoder.teach import FILE, FLAT_GROUND, TEACHER, choose, load_teacher, what_teaches

SMALL, ESPNET = (UnifiedEncoder(name) for name in ("small", "espnetv2-s1"))
ALL = {"depth", "lidar", "cls"}
BACKBONE, DEPTH, CLASSES = ({part: "a.pth"} for part in ("backbone", "depth_head", "class_head"))


@pytest.mark.parametrize(
    ("head", "model", "weights", "known", "teacher", "expected"),
    [
        ("depth_head", SMALL, None, ALL, False, "dense depth"),
        ("depth_head", SMALL, None, {"lidar", "cls"}, False, "LiDAR"),
        ("depth_head", SMALL, "encoder.pt", ALL, False, "dense depth"),  # a checkpoint is where fitting starts
        ("depth_head", SMALL, DEPTH, ALL, False, FILE),  # a published head stays
        ("depth_head", SMALL, "encoder.pt", {"cls"}, False, FILE),
        ("depth_head", SMALL, BACKBONE | DEPTH, {"cls"}, False, FILE),
        ("depth_head", ESPNET, None, {"cls"}, False, FLAT_GROUND),
        ("depth_head", ESPNET, BACKBONE, {"cls"}, True, FLAT_GROUND),
        ("class_head", SMALL, None, ALL, True, "class truth"),
        ("class_head", SMALL, None, {"lidar"}, True, TEACHER),
        ("class_head", SMALL, CLASSES, {"lidar"}, True, FILE),
        ("class_head", SMALL, BACKBONE | CLASSES, {"lidar"}, False, FILE),
        ("class_head", ESPNET, BACKBONE, {"lidar"}, False, FILE),  # its classes are the backbone's
    ],
)
def test_each_head_has_one_source(
    head: str, model: UnifiedEncoder, weights: object, known: set[str], teacher: bool, expected: str
) -> None:
    assert what_teaches(head, model, weights, known, teacher=teacher) == expected  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("head", "model", "weights", "known", "lacking"),
    [
        ("depth_head", SMALL, None, {"cls"}, r"depth or LiDAR.* no depth_head:.*a drive with LiDAR"),
        ("depth_head", SMALL, DEPTH, {"cls"}, "no backbone"),
        ("class_head", SMALL, None, {"depth"}, r"class truth.* no class_head:.*an encoder\.teacher"),
        ("class_head", SMALL, CLASSES, {"depth"}, "no backbone"),
        ("class_head", ESPNET, None, {"depth"}, "no backbone"),
    ],
)
def test_a_head_that_nothing_teaches_is_refused(
    head: str, model: UnifiedEncoder, weights: object, known: set[str], lacking: str
) -> None:
    with pytest.raises(InputError, match=lacking):
        what_teaches(head, model, weights, known, teacher=False)  # type: ignore[arg-type]


def test_gradients_flow_where_something_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    model = UnifiedEncoder("small")
    lessons = choose(model, "encoder.pt", {"depth"}, teacher=False, frozen=False)
    assert lessons == {"depth_head": "dense depth", "class_head": FILE}
    moving = {name for name, part in model.named_children() if any(p.requires_grad for p in part.parameters())}
    assert moving == {"backbone", "depth_head"}
    assert "class_head" in capsys.readouterr().out  # it does not move with its backbone
    choose(model, "encoder.pt", {"depth"}, teacher=False, frozen=True)
    assert not any(parameter.requires_grad for parameter in model.backbone.parameters())
    assert capsys.readouterr().out == ""
    with pytest.raises(InputError, match="nothing is left to fit"):
        choose(model, BACKBONE | DEPTH | CLASSES, {"depth"}, teacher=False, frozen=True)


def test_a_teacher_is_an_encoder_with_classes(tmp_path: Path) -> None:
    torch.manual_seed(0)
    perceive.save(tmp_path, "small", UnifiedEncoder("small").state_dict())
    teach, (source,) = load_teacher("small", str(tmp_path / "encoder.pt"), "encoder.teacher")
    assert source.part == "all"
    image = np.random.default_rng(0).integers(0, 256, (32, 64, 3), np.uint8)
    taught = teach(image, np.array([[40.0, 0, 31], [0, 40, 12], [0, 0, 1]]))
    assert (taught.dtype, taught.shape) == (np.uint8, (32, 64))
    assert taught.max() < classes.COUNT
    with pytest.raises(InputError, match=r"encoder\.teacher\.weights names no class_head"):
        load_teacher("small", BACKBONE, "encoder.teacher")
    with pytest.raises(InputError, match=r"encoder\.teacher\.backbone: .*'smal'"):
        load_teacher("smal", "a.pt", "encoder.teacher")
