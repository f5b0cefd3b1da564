"""A stage's format is in one file of its package, and agrees with data/README.md and with files."""

import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest

from pipeline.base.checkout import ROOT
from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant
from steer.artefact import FORMATS, open_drive
from tests import artefacts, street
from tests.flat_ground import write_encoder
from tests.test_dvc_yaml import _with_imports
from tests.test_no_future import write_files

# Formats whose files describe their datasets.
DESCRIBED = [module for module in FORMATS if hasattr(module, "DESCRIBED")]
# Datasets that the table of each file describes.
COMMON = {"frame", "time_s"}


class Row(NamedTuple):
    """What data/README.md says about a dataset."""

    types: set[str]  # NumPy's names
    ndim: int
    unit: str
    meaning: str


def documented(stage: str) -> dict[str, Row]:
    """Return dataset → row of the table of a stage in data/README.md."""
    _, _, text = (ROOT / "data/README.md").read_text().partition(f"\n| in `{stage}/` | ")
    table, _, _ = text.partition("\n\n")
    rows = {}
    for line in table.splitlines()[2:]:
        cells = [cell.strip() for cell in line.removesuffix("|").strip("|").split(" |", 3)]
        names, described, unit, meaning = cells
        types, _, shape = described.partition(" [")
        for name in re.findall("`([^`]+)`", names):
            ndim = len(shape.split(","))
            rows[name] = Row({*types.split(" or ")}, ndim, unit, meaning.replace("`", ""))
    return rows


@pytest.mark.parametrize("module", FORMATS, ids=lambda module: module.STAGE)
def test_tables_of_the_data_card_have_the_datasets_and_units_of_the_formats(module):
    units = {name: row.unit for name, row in documented(module.STAGE).items()}
    assert units == {name: unit for name, unit in module.UNITS.items() if name not in COMMON}


@pytest.mark.parametrize("module", FORMATS, ids=lambda module: module.STAGE)
def test_a_format_imports_nothing_that_computes(module):
    """So a reader of a file depends on its layout alone."""
    path = Path(*module.__name__.split(".")).with_suffix(".py")
    imported = _with_imports({path}) - {path, Path("pipeline/camera/classes.py")}
    assert {file.parent for file in imported} == {Path("pipeline/base")}


def test_the_table_of_classes_is_that_of_the_code():
    _, _, text = (ROOT / "data/README.md").read_text().partition("\n| trainId | ")
    table, _, _ = text.partition("\n\n")
    expected = []
    for number, (name, colour) in enumerate(zip(classes.NAMES, classes.COLOURS, strict=True)):
        expected.append(f"| {number} | {name} | {', '.join(str(value) for value in colour)} |")
    assert table.splitlines()[2:] == expected


def test_every_format_is_shown():
    paths = (ROOT / "pipeline").glob("*/*.py")
    formats = {path.stem for path in paths if "\nVERSIONS = " in path.read_text()}
    assert {module.__name__.split(".")[-1] for module in FORMATS} == formats


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> list[Path]:
    """Return files of all stages. Together they have all datasets but recorded angles."""
    folder = tmp_path_factory.mktemp("formats")
    with pytest.MonkeyPatch.context() as patch:
        encoder = write_encoder(folder / "encoder", patch)
        images = [street.view(pose)[0] for pose in street.arc(4, 0.2, 8.0)]
        write_files(folder, images, encoder)
    street.write_drive(folder, "dense", frames=2, lidar=True)
    frame = np.arange(3)
    artefacts.write_recorded(folder / "angles.h5", frame, steering_rad={0: 0.1})
    artefacts.write_labels(folder / "labels.h5", frame / 10, frame, ahead_m=[0, 5])
    graphs_drive(folder / "images.h5", folder / "ingest.h5", Variant(source="ingest"))
    return sorted(folder.glob("*.h5"))


def test_files_have_the_datasets_units_and_types_of_the_formats(files):
    written: dict[str, set[str]] = {module.STAGE: set() for module in FORMATS}
    for module, file in open_all(files):
        rows = documented(module.STAGE)
        assert file.attrs["schema"] == module.VERSIONS[-1]
        assert file.units == {name: module.UNITS[name] for name in file.datasets}
        written[module.STAGE] |= {*file.datasets}
        for name in {*file.datasets} - COMMON:
            assert file.datasets[name].dtype.name in rows[name].types, name
            assert file.datasets[name].ndim == rows[name].ndim, name
    assert written == {module.STAGE: {*module.UNITS} for module in FORMATS}


@pytest.mark.parametrize("module", DESCRIBED, ids=lambda module: module.STAGE)
def test_files_describe_their_datasets_and_classes(module, files):
    """In the words of data/README.md."""
    rows = documented(module.STAGE)
    described = set()
    for of_file, file in open_all(files):
        if of_file is module:
            assert {*file.meanings} == {*file.datasets}
            described |= {*file.datasets}
            for name in {*file.datasets} - COMMON:
                assert file.meanings[name] == rows[name].meaning
            if "cls" in file:
                attributes = file.datasets["cls"].attrs
                assert (*attributes["class_names"].astype(str),) == classes.NAMES
                np.testing.assert_array_equal(attributes["class_colours"], classes.COLOURS)
    assert described == {*module.UNITS}


def open_all(files: list[Path]) -> Iterator[tuple[ModuleType, DriveReader]]:
    """Yield the format and the reader of each file."""
    formats = {module.STAGE: module for module in FORMATS}
    for path in files:
        with open_drive(path) as file:
            yield formats[str(file.attrs["stage"])], file
