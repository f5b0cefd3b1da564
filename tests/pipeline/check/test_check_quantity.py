"""The contract of quantities: faults are named, and right ones pass, whatever the labels have."""

from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.check.check_quantity import check_quantity
from pipeline.labels.settings import Labels
from pipeline.train import quantity
from pipeline.train.quantities import angle

CAR = {"wheelbase_m": 2.7, "min_speed_mps": 1.0}
EDGES_M = [0.0, 5.0, 10.0, 200.0]


def check(target: type[quantity.Quantity], **settings: Any) -> None:
    labels = Labels(**CAR | settings)
    check_quantity(target(labels.model_dump()), labels)


@pytest.mark.parametrize("labels", [{}, {"source": "motion"}, {"angle": "recorded"}])
@pytest.mark.parametrize("name", quantity.NAMES)
def test_our_own_quantities_keep_the_contract(name, labels):
    for ahead_m in (EDGES_M, [3.0, 7.0]):
        check(quantity.load_quantity(name), ahead_m=ahead_m, **labels)


@pytest.mark.parametrize(("source_of_angle", "unknown"), [("computed", 0), ("recorded", 10)])
def test_a_quantity_is_tried_on_valid_labels_of_unknown_speed(source_of_angle, unknown):
    """Only a recorded angle is valid without a speed."""
    counts = list[int]()

    def read(target: quantity.Quantity, labels: DriveReader) -> np.ndarray:
        speed_mps = np.where(labels["valid"], labels["speed_mps"], 0.0)
        counts.append(int(np.isnan(speed_mps).sum()))
        return speed_mps[:, None]

    methods = {"read": read, "rescale": lambda target, values, factor: values}
    check(type("Target", (angle.Target,), methods), angle=source_of_angle)
    assert counts == [unknown]


@pytest.mark.parametrize(
    ("method", "change", "message"),
    [
        ("read", lambda q, labels: labels["roll_rad"][:, None], r"read: no dataset 'roll_rad' .it"),
        ("read", lambda q, labels: labels["ahead_1pm"], "read: no dataset 'ahead_1pm'.*Set what"),
        (
            "read",
            lambda q, labels: labels["steering_rad"],
            r"read returns the shape \[600\], expected \[600, 1\]\. See docs",
        ),
        ("read", lambda q, labels: labels["speed_mps"][:, None] + np.inf, "read returns infinity"),
        ("measured", lambda q, angle_rad: angle_rad, r"measured returns the shape \[600\]"),
        ("measured", lambda q, angle_rad: np.exp(1e4 + angle_rad)[:, None], "returns infinity"),
        ("rescale", lambda q, values, factor: values[:, 0], r"rescale.* the shape \[600\], expec"),
        ("rescale_measured", lambda q, values, factor: 1, r"rescale_measured.* the shape \[\], ex"),
        (
            "rescale",
            lambda q, values, factor: np.nan_to_num(values),
            "rescale returns numbers where all values are unknown. Return NaN",
        ),
        ("rescale", lambda q, values, factor: 2 * values, "by a factor of 1 returns other values"),
        ("shown", lambda q, values: values[:, 0], r"shown returns the shape \[1, 1\], expected"),
        ("curvature", lambda q, values: values[:, 0], r"curvature returns the shape \[600\], exp"),
        ("errors", lambda q, predicted, truth: truth, r"errors returns the shape \[600, 1\]"),
        ("lead", "at 20 m", r"lead is 'at 20 m', ends are \[\]. Set measure, ends and lead"),
        ("measure", quantity.NMSE._replace(unit="m"), r"lead is '', ends are \[\]"),
    ],
)
def test_a_faulty_quantity_is_one_line(method, change: Any, message):
    target = type("Target", (angle.Target,), {method: change})
    with np.errstate(over="ignore"), pytest.raises(InputError, match=message) as raised:
        check(target)
    assert "\n" not in str(raised.value)
