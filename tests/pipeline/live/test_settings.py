"""Settings that lead to a network's input agree with the artefacts that it was trained on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import load, load_entry
from pipeline.base.resume import ROOT
from pipeline.live.settings import focal_by_width, load_settings
from pipeline.settings.clouds import Clouds
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import Ingest
from pipeline.settings.perception import Perception

DRIVE, PARAMS = "2026_01_01_drive_0001", ROOT / "params.yaml"


def write(data: Path, folder: str, section: dict[str, Any]) -> None:
    stage = folder.split("/")[0]
    with store.DriveWriter(data / folder / f"{DRIVE}.h5", stage=stage, drive=DRIVE, params={stage: section}) as file:
        file.put("frame", np.arange(2))
        file.put("image", np.zeros((2, 4, 8, 3), np.uint8))
        file.put("K", np.diag([6.0, 6.0, 1.0]))
    store.write_index(data / folder, {DRIVE: "train"})


def test_settings_of_other_artefacts_are_refused(tmp_path: Path) -> None:
    sections = {
        "ingest": load(Ingest, PARAMS).model_dump(mode="json") | {"cameras": [9]},
        "perception": load(Perception, PARAMS).model_dump(mode="json") | {"batch": 77},
        "clouds/pseudo": load(Clouds, PARAMS).model_dump(mode="json"),
        "graphs/semantic": load_entry(Variant, "graphs", "semantic", PARAMS).model_dump(mode="json"),
    }
    for folder, section in sections.items():
        write(tmp_path, folder, section)
    load_settings(PARAMS, "semantic", tmp_path)  # neither cameras nor batch change a network's input
    assert focal_by_width(tmp_path) == 0.75
    assert focal_by_width(tmp_path / "none") is None
    for folder, key in (("graphs/semantic", "k"), ("clouds/pseudo", "max_points"), ("perception", "reach")):
        write(tmp_path, folder, sections[folder] | {key: 3.5})
        with pytest.raises(InputError, match=rf"{key} = .*made with 3\.5"):
            load_settings(PARAMS, "semantic", tmp_path)
        write(tmp_path, folder, sections[folder])
