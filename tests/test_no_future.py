"""No future in an input: frames after t change no input of a model at t."""

from pathlib import Path

import h5py
import numpy as np

from pipeline.camera.camera import Frame
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.graph_file import open_graphs
from pipeline.graphs.settings import Variant
from pipeline.ingest.drive import Drive
from pipeline.ingest.settings import Reading
from pipeline.ingest.write import write_drive
from pipeline.motion.measure import measure_drive
from pipeline.motion.motion_file import open_motion
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception
from pipeline.train.quantity import load_quantity
from pipeline.train.targets import Timeline
from pipeline.train.windows import Reader, Span
from tests import artefacts, small_model, street
from tests.flat_ground import write_encoder

# Number of frames of the drive, and of those that a causal value may depend on.
FRAMES = 14
KNOWN = 8
# Number of frames of a window.
WINDOW = 4
READING = Reading(image_size=street.WIDE.size, cameras=[2], lidar=False, on_damaged="fail")
VARIANT = Variant(source="clouds/pseudo", points=200, k=4, keep_inter_class=0.2)


def write_files(folder: Path, images: list[np.ndarray], encoder: Path) -> None:
    """Write the files of a drive that a model reads, graphs.h5 and motion.h5, and those before."""
    ingest = folder / "ingest.h5"
    perception = folder / "perception.h5"
    clouds = folder / "clouds.h5"
    frames = [Frame(number, number / 10, image) for number, image in enumerate(images)]
    write_drive(ingest, Drive(street.WIDE, lambda: iter(frames)), "drive", "kitti", READING)
    perceive_drive(perception, ingest, encoder, Perception(batch=4))
    measure_drive(folder / "motion.h5", ingest, perception)
    settings = Clouds(max_points=2000, max_depth_m=80.0, seed=0)
    clouds_drive(clouds, "pseudo", ingest, perception, settings)
    graphs_drive(folder / "graphs.h5", clouds, VARIANT)


def read_inputs(folder: Path) -> dict[str, np.ndarray]:
    """Return the batch that a model with motion gets of the frames up to KNOWN."""
    entry = small_model.entry(motion="visual", window=WINDOW)
    quantity = load_quantity(entry.predict)(artefacts.LABELS["labels"])
    with open_graphs(folder / "graphs.h5") as graphs, open_motion(folder / "motion.h5") as motion:
        timeline = Timeline.read(graphs, motion, quantity, entry)
    batch = Reader([timeline], WINDOW)[[Span(0, 0, KNOWN)]]
    return {name: values.numpy() for name, values in batch.items()}


def spoil_smooth(folder: Path) -> None:
    """Replace the motion that is smoothed by later frames with wrong values."""
    with h5py.File(folder / "motion.h5", "r+") as motion:
        names = [name for name in motion if name.startswith("smooth_")]
        assert len(names) == 4
        for name in names:
            motion[name][:] = 99.0


def test_later_frames_and_smoothed_motion_change_no_input(tmp_path, monkeypatch):
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    images = [street.view(pose)[0] for pose in street.arc(FRAMES, 0.2, 8.0)]
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (FRAMES - KNOWN, *street.WIDE.size, 3), np.uint8)
    write_files(tmp_path / "one", images, encoder)
    write_files(tmp_path / "other", [*images[:KNOWN], *noise], encoder)
    smoothed = []
    for folder in ("one", "other"):
        with open_motion(tmp_path / folder / "motion.h5") as motion:
            assert motion["valid"][1:KNOWN].all()
            smoothed.append(motion["smooth_speed_mps"][:KNOWN])
    assert not np.array_equal(*smoothed)
    spoil_smooth(tmp_path / "other")

    inputs = read_inputs(tmp_path / "one")
    others = read_inputs(tmp_path / "other")
    assert inputs.keys() == others.keys() > {"xyz", "cls", "indices", "dt_s", "motion", "base"}
    assert inputs["base"].all()
    for name, values in inputs.items():
        np.testing.assert_array_equal(values, others[name], err_msg=name)
