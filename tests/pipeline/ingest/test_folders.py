"""The example of a dataset of one's own, through stage ingest."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.ingest.datasets.folders import CAMERA
from pipeline.ingest.ingest_file import open_ingest
from stages import ingest
from tests.kitti_drive import pictures, write, write_params, write_png


def test_frames_and_angles_of_a_drive(tmp_path):
    for name in ("hills", "town"):
        for number, image in enumerate(pictures(3, CAMERA.size)):
            write_png(tmp_path / f"raw/{name}/{number:04d}.png", image)
        write(tmp_path / f"raw/{name}/steering.csv", "frame,steering_rad\n0,0.1\n1,\n2,-0.05\n")
    params = write_params(tmp_path / "params.yaml", ["hills"], ["town"], source="folders")
    out = ingest.main(tmp_path / "data", tmp_path / "raw", params)
    with open_ingest(out / "hills.h5") as file:
        np.testing.assert_allclose(file["steering_rad"], [0.1, 0, -0.05])
        assert file["has_steering"].tolist() == [1, 0, 1]
        np.testing.assert_allclose(file.time_s, [0, 0.1, 0.2])
        assert file["has_image"].all()
        assert file.params["dataset"] == "folders"


def test_a_fingerprint_that_json_cannot_store(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.ingest.datasets.folders.fingerprint", lambda *_: [Path("a")])
    params = write_params(tmp_path / "params.yaml", ["hills"], ["town"], source="folders")
    with pytest.raises(InputError, match=r"hills: fingerprint is not JSON-able .*Path"):
        ingest.main(tmp_path / "data", tmp_path / "raw", params)
