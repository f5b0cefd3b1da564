"""A dataset in one file: Udacity's Challenge 2, through stage ingest."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from stages import ingest
from tests.kitti_drive import pictures, write, write_params, write_video

SIZE = (480, 640)


def test_frames_and_angles_of_a_drive(tmp_path):
    folder = tmp_path / "raw/udacity"
    wheel_rad = {"hills": [0.37, -0.74, 0.0, 1.48], "town": [0.0, 0.1, 0.2, 0.3]}
    for name, angles in wheel_rad.items():
        rows = "".join(f"{number / 20:.4f},{angle}\n" for number, angle in enumerate(angles))
        write(folder / f"{name}.csv", "time_s,wheel_rad\n" + rows)
        write_video(folder / f"{name}.mp4", pictures(4, SIZE), fps=20.0)
    params = write_params(tmp_path / "params.yaml", ["hills"], ["town"], source="udacity")
    out = ingest.main(tmp_path / "data", tmp_path / "raw", params)
    with DriveReader(out / "hills.h5", stage="ingest") as file:
        np.testing.assert_allclose(file["steering_rad"], [0.025, -0.05, 0, 0.1])
        np.testing.assert_allclose(file.time_s, np.arange(4) / 20)
        assert "oxts" not in file
        assert file["has_image"].tolist() == [1] * 4
        assert file.params["dataset"] == "udacity"

    write(folder / "town.csv", "time_s,wheel_rad\n0,0\n0.1,0\n0.2,\n0.05,0\n")
    with pytest.raises(InputError, match=r"town.csv: time_s does not increase"):
        ingest.main(tmp_path / "data", tmp_path / "raw", params)
    write(folder / "town.csv", "time_s,wheel_rad\n0,0\n0.1,0\n")
    with pytest.raises(InputError, match=r"town.csv: has 2 rows, the video 4 frames"):
        ingest.main(tmp_path / "data", tmp_path / "raw", params)
    (folder / "town.csv").unlink()
    with pytest.raises(InputError, match=r"town.csv: file is missing"):
        ingest.main(tmp_path / "data", tmp_path / "raw", params)
