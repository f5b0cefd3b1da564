"""Name and colour the 19 Cityscapes classes by trainId, the only class numbers in this project."""

import numpy as np

NAMES = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign",
    "vegetation", "terrain",
    "sky", "person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle",
)  # fmt: skip
COUNT = len(NAMES)
VOID = 255
(
    ROAD, SIDEWALK, BUILDING, WALL, FENCE, POLE, TRAFFIC_LIGHT, TRAFFIC_SIGN, VEGETATION, TERRAIN,
    SKY, PERSON, RIDER, CAR, TRUCK, BUS, TRAIN, MOTORCYCLE, BICYCLE,
) = range(COUNT)  # fmt: skip
GROUND = (ROAD, SIDEWALK, TERRAIN)
TRAFFIC = (PERSON, RIDER, CAR, TRUCK, BUS, TRAIN, MOTORCYCLE, BICYCLE)  # on the ground, may move

# The colours of the Cityscapes benchmark, RGB.
COLOURS = np.array(
    [
        (128, 64, 128), (244, 35, 232), (70, 70, 70), (102, 102, 156), (190, 153, 153),
        (153, 153, 153), (250, 170, 30),
        (220, 220, 0), (107, 142, 35), (152, 251, 152), (70, 130, 180), (220, 20, 60), (255, 0, 0),
        (0, 0, 142),
        (0, 0, 70), (0, 60, 100), (0, 80, 100), (0, 0, 230), (119, 11, 32),
    ],
    dtype=np.uint8,
)  # fmt: skip


def colourise(classes: np.ndarray) -> np.ndarray:
    """Return uint8 RGB [..., 3] for class numbers [...]; void is black."""
    table = np.zeros((256, 3), np.uint8)
    table[:COUNT] = COLOURS
    return table[classes]
