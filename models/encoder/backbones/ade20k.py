"""ADE20K's 150 classes (SceneParse150, Zhou et al. 2017), mapped to Cityscapes' 19 and void."""

import torch
from torch import Tensor

ADE20K = (
    "wall", "building", "sky", "floor", "tree", "ceiling", "road", "bed", "windowpane", "grass", "cabinet", "sidewalk",
    "person", "earth", "door", "table", "mountain", "plant", "curtain", "chair", "car", "water", "painting", "sofa",
    "shelf", "house", "sea", "mirror", "rug", "field", "armchair", "seat", "fence", "desk", "rock", "wardrobe", "lamp",
    "bathtub", "railing", "cushion", "base", "box", "column", "signboard", "chest of drawers", "counter", "sand",
    "sink", "skyscraper", "fireplace", "refrigerator", "grandstand", "path", "stairs", "runway", "case", "pool table",
    "pillow", "screen door", "stairway", "river", "bridge", "bookcase", "blind", "coffee table", "toilet", "flower",
    "book", "hill", "bench", "countertop", "stove", "palm", "kitchen island", "computer", "swivel chair", "boat",
    "bar", "arcade machine", "hovel", "bus", "towel", "light", "truck", "tower", "chandelier", "awning", "streetlight",
    "booth", "television", "airplane", "dirt track", "apparel", "pole", "land", "bannister", "escalator", "ottoman",
    "bottle", "buffet", "poster", "stage", "van", "ship", "fountain", "conveyer belt", "canopy", "washer", "plaything",
    "swimming pool", "stool", "barrel", "basket", "waterfall", "tent", "bag", "minibike", "cradle", "oven", "ball",
    "food", "step", "tank", "trade name", "microwave", "pot", "animal", "bicycle", "lake", "dishwasher", "screen",
    "blanket", "sculpture", "hood", "sconce", "vase", "traffic light", "tray", "ashcan", "fan", "pier", "crt screen",
    "plate", "monitor", "bulletin board", "shower", "radiator", "glass", "clock", "flag",
)  # fmt: skip

# Cityscapes classes in the order of their trainIds. ADE20K has no class for rider and train. All classes that are not
# listed are void, bridges among them, as in Cityscapes.
CITYSCAPES = {
    "road": "road, runway, dirt track",
    "sidewalk": "sidewalk, path, floor",
    "building": "building, house, skyscraper, tower, hovel, booth, grandstand, awning, canopy, windowpane, door, "
    "screen door, blind, column, stairs, stairway, step, trade name",
    "wall": "wall",
    "fence": "fence, railing, bannister",
    "pole": "pole, streetlight",
    "traffic light": "traffic light",
    "traffic sign": "signboard",
    "vegetation": "tree, plant, palm, flower",
    "terrain": "grass, earth, field, land, sand, rock, hill, mountain",
    "sky": "sky",
    "person": "person",
    "rider": "",
    "car": "car, van",
    "truck": "truck",
    "bus": "bus",
    "train": "",
    "motorcycle": "minibike",
    "bicycle": "bicycle",
}
_GROUPS = [sorted(ADE20K.index(name) for name in names.split(", ") if name) for names in CITYSCAPES.values()]
GROUPS = [*_GROUPS, sorted({*range(len(ADE20K))}.difference(*_GROUPS))]
"""Numbers of ADE20K's classes for each of Cityscapes' classes, and for void."""
MARGIN = 10.0  # of a class without members, below the least likely other


def to_cityscapes(logits: Tensor) -> Tensor:
    """Map logits [B,150,H,W] of ADE20K to logits [B,20,H,W] of Cityscapes' classes and void.

    A class has the summed probability of its members. A class without members is below all others, so that it is never
    predicted, also between interpolated pixels, and has a finite loss as a target.
    """
    gathered = {target: torch.logsumexp(logits[:, group], dim=1) for target, group in enumerate(GROUPS) if group}
    # Without gradients, which would train the least likely class.
    never = torch.stack(list(gathered.values())).amin(dim=0).detach() - MARGIN
    return torch.stack([gathered.get(target, never) for target in range(len(GROUPS))], dim=1)
