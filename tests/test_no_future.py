"""No future in an input: frames after t change no input of a model at t."""

from pathlib import Path

import h5py
import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.camera import Frame
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.settings import Reading
from pipeline.motion.motion_file import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception
from tests import street
from tests.flat_ground import write_encoder

# Number of frames of the drive, and of those that a causal value may depend on.
FRAMES = 14
KNOWN = 8
READING = Reading(image_size=street.WIDE.size, cameras=[2], lidar=False, on_damaged="fail")
VARIANT = Variant(source="clouds/pseudo", points=200, k=4, keep_inter_class=0.2)


def inputs(folder: Path, images: list[np.ndarray], encoder: Path) -> dict[str, np.ndarray]:
    """Return the datasets of the graph file of a drive, of the frames up to KNOWN."""
    files = {
        name: folder / f"{name}.h5"
        for name in ("ingest", "perception", "motion", "clouds", "graphs")
    }
    frames = [Frame(number, number / 10, image) for number, image in enumerate(images)]
    write_drive(
        files["ingest"], Drive(street.WIDE, lambda: iter(frames)), "drive", "kitti", READING
    )
    settings = Perception(batch=4)
    perceive_drive(files["perception"], files["ingest"], encoder, settings)
    measure_drive(files["motion"], files["ingest"], files["perception"])
    clouds = Clouds(max_points=2000, max_depth_m=80.0, seed=0)
    clouds_drive(files["clouds"], "pseudo", files["ingest"], files["perception"], clouds)
    graphs_drive(files["graphs"], files["clouds"], files["motion"], VARIANT)
    with DriveReader(files["graphs"], stage="graphs") as file:
        assert file["motion_valid"][1:KNOWN].all()
        rows = [file.rows_of(name, row) for name in file.pointers for row in range(KNOWN)]
        known = {
            name: file[name][:KNOWN]
            for name, data in file.datasets.items()
            if len(data) == len(images)
        }
    return {**known, "points": np.concatenate([row.ravel() for row in rows])}


def test_later_frames_change_no_input(tmp_path, monkeypatch):
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    images = [street.view(pose)[0] for pose in street.arc(FRAMES, 0.2, 8.0)]
    noise = np.random.default_rng(0).integers(
        0, 255, (FRAMES - KNOWN, *street.WIDE.size, 3), np.uint8
    )
    one = inputs(tmp_path / "one", images, encoder)
    other = inputs(tmp_path / "other", [*images[:KNOWN], *noise], encoder)
    assert (
        one.keys()
        == other.keys()
        > {"motion_speed_mps", "motion_yaw_rate_radps", "motion_valid", "time_s"}
    )
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


def test_graphs_have_no_smoothed_motion(tmp_path, monkeypatch):
    """Smoothed values depend on later frames. A graph file is the same without them."""
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    images = [street.view(pose)[0] for pose in street.arc(FRAMES, 0.2, 8.0)]
    inputs(tmp_path, images, encoder)
    graphs = (tmp_path / "graphs.h5").read_bytes()
    with h5py.File(tmp_path / "motion.h5", "a") as file:
        smoothed = [name for name in file if name.startswith("smooth_")]
        for name in smoothed:
            del file[name]
    assert smoothed
    graphs_drive(tmp_path / "other.h5", tmp_path / "clouds.h5", tmp_path / "motion.h5", VARIANT)
    assert (tmp_path / "other.h5").read_bytes() == graphs
