import pytest

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.perception.supervision import Supervision, choose, supervision
from pipeline.sections.encoder import Weights

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
