import torch

from models.encoder.backbones.ade20k import ADE20K, TARGET, to_cityscapes
from pipeline.camera import classes


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
