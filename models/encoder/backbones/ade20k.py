"""ADE20K's 150 classes (SceneParse150, Zhou et al. 2017), each given to one of Cityscapes' 19 or to void."""

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

# Cityscapes classes in the order of their trainIds. It has no class of ADE20K for rider and train; bridges are void in
# Cityscapes, and so is what stands in houses.
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
    "void": "ceiling, bed, cabinet, table, curtain, chair, water, painting, sofa, shelf, sea, mirror, rug, armchair, "
    "seat, desk, wardrobe, lamp, bathtub, cushion, base, box, chest of drawers, counter, sink, fireplace, "
    "refrigerator, case, pool table, pillow, river, bridge, bookcase, coffee table, toilet, book, bench, countertop, "
    "stove, kitchen island, computer, swivel chair, boat, bar, arcade machine, towel, light, chandelier, television, "
    "airplane, apparel, escalator, ottoman, bottle, buffet, poster, stage, ship, fountain, conveyer belt, washer, "
    "plaything, swimming pool, stool, barrel, basket, waterfall, tent, bag, cradle, oven, ball, food, tank, microwave, "
    "pot, animal, lake, dishwasher, screen, blanket, sculpture, hood, sconce, vase, tray, ashcan, fan, pier, "
    "crt screen, plate, monitor, bulletin board, shower, radiator, glass, clock, flag",
}
TARGET = {name: number for number, names in enumerate(CITYSCAPES.values()) for name in names.split(", ") if name}
MARGIN = 10.0  # of a class that gathers none, below the least likely other


def to_cityscapes(logits: Tensor) -> Tensor:
    """Return logits [B,20,H,W] of Cityscapes' classes and void from those of ADE20K, [B,150,H,W].

    A class has the summed probability of those it gathers. One that gathers none lies below all others: it is never
    chosen, between interpolated pixels neither, and as a truth costs a finite loss, not thousands.
    """
    groups = [
        [number for number, name in enumerate(ADE20K) if TARGET[name] == target] for target in range(len(CITYSCAPES))
    ]
    gathered = {target: torch.logsumexp(logits[:, group], dim=1) for target, group in enumerate(groups) if group}
    # Without gradients: a pixel of such a class must not teach the least likely one.
    never = torch.stack(list(gathered.values())).amin(dim=0).detach() - MARGIN
    return torch.stack([gathered.get(target, never) for target in range(len(groups))], dim=1)
