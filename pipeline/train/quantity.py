"""The interface of a quantity that networks predict, a file ``pipeline/train/quantities/NAME.py``.

`predict: NAME` in params.yaml stands for this file, which is listed nowhere else. It has one class,
Target(Quantity). docs/models.md has an example.

Letters: F frames of a drive, W windows, R columns of a quantity, E ends of a path.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pipeline.base.errors import InputError, closest
from pipeline.base.store import DriveReader
from pipeline.labels.label import Car

# Names of the quantities. Each is the name of a file.
NAMES = sorted(path.stem for path in (Path(__file__).parent / "quantities").glob("[!_]*.py"))
# Length in metres of the path that is drawn for a value of the present.
HELD_M = 20.0


class Measure(NamedTuple):
    """How an error is stated in tables and sentences."""

    title: str
    unit: str  # empty if it has none
    digits: int  # decimal places, which tables show and verdicts are read from
    meaning: str  # a sentence

    @property
    def form(self) -> str:
        """The format of a value. A value that is rounded to 0 has no minus (z)."""
        return f"z.{self.digits}f"

    @property
    def signed_form(self) -> str:
        """The format of a difference."""
        return f"+{self.form}"


NMSE = Measure(
    "nmse",
    "",
    3,
    "nmse is the squared error relative to that of always predicting zero: 0 is perfect, and 1 is "
    "as bad as always predicting zero.",
)


class Quantity(ABC):
    """A quantity of a drive's frames: how to read, scale and show its R columns.

    Values that are unknown are NaN.
    """

    # Title and unit of its values.
    title: ClassVar[str]
    unit: ClassVar[str]
    # Title, unit and format of the number that :meth:`shown` returns.
    shown_title: ClassVar[str]
    shown_unit: ClassVar[str]
    shown_format: ClassVar[str] = ".3g"
    # How the error that leads tables, headline and verdict is stated. By default, nmse leads.
    measure: ClassVar[Measure] = NMSE

    # Whether the values lie ahead of the car, also with a horizon of 0. Then the measured motion
    # does not determine them, and the truth of the frame before is not known to the car.
    is_ahead: ClassVar[bool] = False
    # Whether the values change their sign in the mirror image, as an equivariant network's do.
    is_odd: ClassVar[bool] = True
    # Whether the loss is linear beyond one standard deviation, see loss.weighted_loss.
    is_robust: ClassVar[bool] = False
    # Keys of a model's entry that have no meaning for the quantity, and are refused with it.
    excluded_keys: ClassVar[Sequence[str]] = ()

    # Names of the columns, with their unit. They are in predictions.csv and in checkpoints.
    columns: list[str]
    # Name of each column's range in tables; empty for a single column.
    ranges: list[str]
    # Edges in metres of the ranges in which :meth:`curvature` is constant.
    edges_m: list[float]
    # Names of the errors that :meth:`errors` returns, none if the quantity has only an nmse, and
    # the name of the one that leads; it is empty if nmse leads.
    ends: Sequence[str] = ()
    lead: str = ""

    def __init__(self, labels: Mapping[str, Any], horizon: int = 0) -> None:
        """Store the settings.

        `labels` is section labels of the settings that made the labels, and `horizon` the number of
        frames between the last input frame and the frame of the values. Raises InputError if the
        labels lack the quantity.
        """
        self.car = Car(labels["wheelbase_m"], labels["min_speed_mps"])
        self.horizon = horizon
        self.ranges = [""]
        self.edges_m = [0.0, HELD_M]

    @abstractmethod
    def read(self, labels: DriveReader) -> np.ndarray:
        """Return the true values in a file of stage labels, float64 [F,R]."""

    @abstractmethod
    def measured(self, angle_rad: np.ndarray) -> np.ndarray:
        """Return the values [F,R] if the car held the measured angle [F].

        They are the base of the network's outputs, and the baseline odometry.
        """

    @abstractmethod
    def rescale(self, values: np.ndarray, factor: float) -> np.ndarray:
        """Return true values [W,R] in a world that is `factor` times as large."""

    def rescale_measured(self, values: np.ndarray, factor: float) -> np.ndarray:
        """Return values [W,R] of :meth:`measured` in a world that is `factor` times as large."""
        return self.rescale(values, factor)

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Return one number per frame for values [..., R]: [...].

        Charts show it, and its mean absolute error stands in tables. It is linear in the values.
        """
        return values[..., 0]

    def errors(self, predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
        """Return the errors [..., N, E] of predictions [..., N, R] of true values [N, R].

        They are in the unit of `measure`, one for each of `ends`, and NaN where a value that an
        error needs is unknown.
        """
        return np.zeros((*predicted.shape[:-1], 0))

    @abstractmethod
    def curvature(self, values: np.ndarray) -> np.ndarray:
        """Return the curvature in 1/m of the path in each range of `edges_m`: [..., R] → [..., K].

        It is drawn in images. It is NaN if the values do not determine a path.
        """

    def angle_rad(self, values: np.ndarray) -> np.ndarray:
        """Return the steering angle [F] of values [F,R]; NaN if they lie ahead of the car."""
        if self.is_ahead:
            return np.full(len(values), np.nan)
        return np.arctan(self.curvature(values)[:, 0] * self.car.wheelbase_m)

    @classmethod
    def title_at(cls, horizon: int) -> str:
        """Return the title with the number of frames ahead, if it is not 0."""
        return f"{cls.title}, {horizon} frames ahead" if horizon else cls.title

    @classmethod
    def axis_title(cls) -> str:
        """Return the unit of :meth:`shown`, and which sign is left."""
        return f"{cls.shown_unit}, left +" if cls.is_odd else cls.shown_unit

    @classmethod
    def text(cls, value: float) -> str:
        """Return a number that :meth:`shown` returned as text with its unit."""
        return f"{value:{cls.shown_format}} {cls.shown_unit}"


def load_quantity(name: str) -> type[Quantity]:
    """Return the class Target of a quantity's file. Raises InputError if there is no file."""
    if name not in NAMES:
        raise InputError(f"there is no {quantity_file(name)} ({closest(name, NAMES)})")
    target: type[Quantity] = importlib.import_module(f"pipeline.train.quantities.{name}").Target
    return target


def quantity_file(name: str) -> str:
    """Return the path of a quantity's file in the checkout."""
    return f"pipeline/train/quantities/{name}.py"


def scale_radius(angle_rad: np.ndarray, factor: float) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length.
    """
    return np.arctan(np.tan(angle_rad) / factor)
