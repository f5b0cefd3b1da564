"""The chain of a stream with a real encoder of random weights."""

from collections.abc import Generator
from pathlib import Path

import numpy as np
import torch
import yaml

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base import store
from pipeline.camera.camera import read_camera
from pipeline.camera.images import to_metres
from pipeline.live.chain import Chain, FrameState
from pipeline.perception.perceive import save
from pipeline.settings.perception import Perception
from stages.perception import main
from tests import street

DRIVE, FRAMES = "2026_01_01_drive_0001", 3


def frames(raw: store.DriveReader) -> Generator[FrameState]:
    for row, number in enumerate(raw.frame.tolist()):
        scan = raw.rows_of("lidar", row)
        yield FrameState(number, number / 10, scan=scan, image=raw.row("image", row))


def test_depth_and_classes_equal_those_of_the_stage(tmp_path: Path) -> None:
    street.write_drive(tmp_path / "ingest", DRIVE, FRAMES, lidar=True)
    store.write_index(tmp_path / "ingest", {DRIVE: "test"})
    torch.manual_seed(0)
    save(tmp_path / "encoder", "small", UnifiedEncoder("small").state_dict())
    settings = {"batch": 2, "depth_scale": "metric", "reach": 1.2, "camera_height_m": 1.65}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump({"perception": settings}))
    main(tmp_path / "ingest", tmp_path / "encoder", tmp_path / "perception", tmp_path / "params.yaml", workers=1)
    with (
        store.DriveReader(tmp_path / "ingest" / f"{DRIVE}.h5", stage="ingest") as raw,
        store.DriveReader(tmp_path / "perception" / f"{DRIVE}.h5", stage="perception") as stored,
    ):
        camera, encoder = read_camera(raw, 1.65), tmp_path / "encoder"
        chain = Chain(camera, DRIVE, encoder, {"visual"}, Perception(**settings), road_scale=True)
        results = list(chain.run(frames(raw)))
        assert len(results) == FRAMES
        for row, frame in enumerate(results):
            np.testing.assert_array_equal(frame.depth_m, to_metres(stored.row("depth_m", row)))
            np.testing.assert_array_equal(frame.cls, stored.row("cls", row))
            assert frame.estimates["visual"] is None  # the street's texture is noise
