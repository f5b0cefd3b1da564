import torch
import torch.nn.functional as F

from models.encoder.backbones.ade20k import ADE20K, CITYSCAPES, TARGET, to_cityscapes
from pipeline.camera import classes


def test_each_class_of_ade20k_has_one_target() -> None:
    listed = [name for names in CITYSCAPES.values() for name in names.split(", ") if name]
    assert len(set(listed)) == len(listed)
    assert set(listed) <= set(ADE20K)
    assert len(set(ADE20K)) == 150
    assert list(CITYSCAPES) == [*classes.NAMES, "void"]


def test_numbers_are_those_of_the_published_list() -> None:
    """Indices in SceneParse150's objectInfo150, from two independent copies."""
    known = {0: "wall", 6: "road", 11: "sidewalk", 12: "person", 20: "car", 43: "signboard", 80: "bus", 83: "truck",
             87: "streetlight", 93: "pole", 102: "van", 116: "minibike", 127: "bicycle", 136: "traffic light",
             149: "flag"}  # fmt: skip
    assert {number: ADE20K[number] for number in known} == known
    assert {classes.NAMES[TARGET[ADE20K[number]]] for number in (1, 25, 48)} == {"building"}


def test_a_class_has_the_summed_probability_of_its_members() -> None:
    logits = torch.randn(2, 150, 3, 4, generator=torch.Generator().manual_seed(0))
    found = to_cityscapes(logits).softmax(1)
    share = logits.softmax(1)
    for target in range(20):
        members = [number for number, name in enumerate(ADE20K) if TARGET[name] == target]
        torch.testing.assert_close(found[:, target], share[:, members].sum(1))


def test_a_class_without_members_is_never_predicted_and_has_a_finite_loss() -> None:
    logits = 30 * torch.randn(1, 150, 6, 8, generator=torch.Generator().manual_seed(0))
    logits[..., 0, 0] -= 300  # all classes of a pixel are far below any constant
    found = to_cityscapes(logits.requires_grad_())
    # Interpolated, as by DINOv2's head: between pixels, each class is less likely than at its own pixel.
    larger = F.interpolate(found, scale_factor=2, mode="bilinear", align_corners=False)
    empty = [classes.NAMES.index(name) for name in ("rider", "train")]
    others = [target for target in range(20) if target not in empty]
    assert (larger[:, empty].amax(1) < larger[:, others].amin(1)).all()

    spread = found[:, others].amax(1) - found[:, others].amin(1)
    loss = F.cross_entropy(found, torch.full((1, 6, 8), empty[0]), reduction="none")
    assert (loss <= spread + 10 + 3.01).all(), "ln 20 = 3.0"
    loss.sum().backward()  # type: ignore[no-untyped-call]
    assert logits.grad is not None
    assert (logits.grad >= 0).all(), "it lowers likely classes and raises none"
