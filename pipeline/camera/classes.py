"""Name and colour the 19 Cityscapes classes by trainId, the only class numbers in this project."""

import numpy as np

ROAD = 0
SIDEWALK = 1
BUILDING = 2
WALL = 3
FENCE = 4
POLE = 5
TRAFFIC_LIGHT = 6
TRAFFIC_SIGN = 7
VEGETATION = 8
TERRAIN = 9
SKY = 10
PERSON = 11
RIDER = 12
CAR = 13
TRUCK = 14
BUS = 15
TRAIN = 16
MOTORCYCLE = 17
BICYCLE = 18

# Number of classes, without void.
COUNT = 19
# Class number of pixels and points that have none of these classes.
VOID = 255
# Classes that are part of the ground.
GROUND = (ROAD, SIDEWALK, TERRAIN)
# Classes that stand on the ground and may move.
TRAFFIC = (PERSON, RIDER, CAR, TRUCK, BUS, TRAIN, MOTORCYCLE, BICYCLE)

# Names of the classes by trainId, as in the Cityscapes benchmark.
NAMES = (
    "road",
    "sidewalk",
    "building",
    "wall",
    "fence",
    "pole",
    "traffic light",
    "traffic sign",
    "vegetation",
    "terrain",
    "sky",
    "person",
    "rider",
    "car",
    "truck",
    "bus",
    "train",
    "motorcycle",
    "bicycle",
)

# RGB colours of the classes by trainId, as in the Cityscapes benchmark.
COLOURS = np.array(
    [
        (128, 64, 128),  # road
        (244, 35, 232),  # sidewalk
        (70, 70, 70),  # building
        (102, 102, 156),  # wall
        (190, 153, 153),  # fence
        (153, 153, 153),  # pole
        (250, 170, 30),  # traffic light
        (220, 220, 0),  # traffic sign
        (107, 142, 35),  # vegetation
        (152, 251, 152),  # terrain
        (70, 130, 180),  # sky
        (220, 20, 60),  # person
        (255, 0, 0),  # rider
        (0, 0, 142),  # car
        (0, 0, 70),  # truck
        (0, 60, 100),  # bus
        (0, 80, 100),  # train
        (0, 0, 230),  # motorcycle
        (119, 11, 32),  # bicycle
    ],
    dtype=np.uint8,
)

# Attributes of a dataset of class numbers that name and colour the classes, so that a reader of the
# file needs no table.
ATTRIBUTES = {"class_names": np.array(NAMES, "S"), "class_colours": COLOURS}


def colour_classes(classes: np.ndarray) -> np.ndarray:
    """Return the RGB colours, uint8 [..., 3], of class numbers [...]. Void is black."""
    table = np.zeros((256, 3), np.uint8)
    table[:COUNT] = COLOURS
    return table[classes]
