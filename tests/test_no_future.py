"""No future in an input: frames after t change no input of a model at t."""

from pathlib import Path

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
    ingest = folder / "ingest.h5"
    perception = folder / "perception.h5"
    motion = folder / "motion.h5"
    clouds = folder / "clouds.h5"
    graphs = folder / "graphs.h5"
    frames = [Frame(number, number / 10, image) for number, image in enumerate(images)]
    write_drive(ingest, Drive(street.WIDE, lambda: iter(frames)), "drive", "kitti", READING)
    perceive_drive(perception, ingest, encoder, Perception(batch=4))
    measure_drive(motion, ingest, perception)
    settings = Clouds(max_points=2000, max_depth_m=80.0, seed=0)
    clouds_drive(clouds, "pseudo", ingest, perception, settings)
    graphs_drive(graphs, clouds, motion, VARIANT)
    with DriveReader(graphs, stage="graphs") as file:
        assert file["motion_valid"][1:KNOWN].all()
        rows = [file.rows_of(name, row) for name in file.pointers for row in range(KNOWN)]
        known = {"points": np.concatenate([row.ravel() for row in rows])}
        for name, data in file.datasets.items():
            if len(data) == len(images):
                known[name] = file[name][:KNOWN]
    return known


def test_later_frames_change_no_input(tmp_path, monkeypatch):
    """Of causal and smoothed motion, a graph file has the causal one."""
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    images = [street.view(pose)[0] for pose in street.arc(FRAMES, 0.2, 8.0)]
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (FRAMES - KNOWN, *street.WIDE.size, 3), np.uint8)
    one = inputs(tmp_path / "one", images, encoder)
    other = inputs(tmp_path / "other", [*images[:KNOWN], *noise], encoder)
    smoothed = []
    for folder in ("one", "other"):
        with DriveReader(tmp_path / folder / "motion.h5", stage="motion") as motion:
            smoothed.append(motion["smooth_speed_mps"][:KNOWN])
    assert not np.array_equal(*smoothed)
    motion_names = {"motion_speed_mps", "motion_yaw_rate_radps", "motion_valid"}
    assert one.keys() == other.keys() > motion_names | {"time_s"}
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)
