"""Stages perception by precomputed files, and clouds of drives with LiDAR, images or both."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.clouds.cloud_file import open_clouds
from pipeline.encoder.encoder_file import save_encoder
from pipeline.encoder.precomputed import describe_sizes, read_frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.settings import Reading
from pipeline.ingest.stored_camera import read_camera
from pipeline.ingest.write import write_drive
from pipeline.motion.measure import measure_drive
from stages import clouds, perception
from steer.artefact import open_drive
from tests import street
from tests.artefacts import write_index
from tests.kitti_drive import write_png

SPLITS = {
    "2026_01_01_drive_0001": "train",
    "2026_01_01_drive_0002": "train",
    "2026_01_03_drive_0001": "test",
}
FULL, BLIND, CAMERA = SPLITS


def read_drive(folder: Path, drive: str) -> dict[str, np.ndarray]:
    with open_drive(folder / f"{drive}.h5") as file:
        return {name: file[name] for name in file.datasets}


def test_drives_without_images_or_lidar_have_clouds_of_what_they_have(tmp_path):
    """A drive without images has no classes in its scans, one without LiDAR has no frames."""
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["ingest"]["lidar"] = True
    params["clouds"]["columns"] = ["intensity"]
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    street.write_drive(tmp_path / "ingest", FULL, 4, lidar=True)
    street.write_drive(tmp_path / "ingest", BLIND, 3, lidar=True, images=False, dense=False)
    street.write_drive(tmp_path / "ingest", CAMERA, 3)
    for drive in SPLITS:
        street.write_perception(tmp_path / "perception", tmp_path / "ingest", drive)
    for drive in (BLIND, CAMERA):
        files = [tmp_path / f"{stage}/{drive}.h5" for stage in ("motion", "ingest", "perception")]
        assert measure_drive(*files)["valid"] == 0
    write_index(tmp_path / "ingest", SPLITS)
    clouds.main(tmp_path, tmp_path / "params.yaml")

    full = read_drive(tmp_path / "clouds/lidar", FULL)
    assert {classes.ROAD, classes.BUILDING} <= set(full["cls"].tolist())
    blind = read_drive(tmp_path / "clouds/lidar", BLIND)
    assert len(blind["xyz"]) > 0
    assert (blind["cls"] == classes.VOID).all()
    camera = read_drive(tmp_path / "clouds/lidar", CAMERA)
    assert len(camera["frame"]) == 0

    # Scans have an intensity, and files of images are as without the setting.
    assert full["intensity"].tolist() == [[0.5]] * len(full["xyz"])
    assert camera["intensity"].shape == (0, 1)
    with open_clouds(tmp_path / f"clouds/pseudo/{FULL}.h5") as file:
        assert "intensity" not in file
        assert "columns" not in file.params["clouds"]

    params["ingest"]["lidar"] = False
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    clouds.main(tmp_path, tmp_path / "params.yaml")
    assert not store.read_index(tmp_path / "clouds/lidar", stage="clouds")


def run(root: Path) -> dict[str, np.ndarray]:
    params = root / "params.yaml"
    params.write_text(yaml.safe_dump({"perception": {"batch": 3}}))
    return read_drive(perception.main(root, params), FULL)


def test_precomputed_files_are_matched_by_frame_number(tmp_path, capsys):
    truth_depth = []
    truth_cls = []
    for frame in range(5):
        _, depth_m, cls = street.scene(frame)
        truth_depth.append(np.rint(depth_m * 256).astype(np.uint16))
        truth_cls.append(cls)
        write_png(tmp_path / f"made/{FULL}/depth/{frame:010d}.png", truth_depth[frame])
        write_png(tmp_path / f"made/{FULL}/cls/{frame:010d}.png", truth_cls[frame])
    street.write_drive(tmp_path / "ingest", FULL, 5)
    with h5py.File(tmp_path / f"ingest/{FULL}.h5", "r+") as file:
        file["has_image"][:] = [1, 1, 0, 1, 1]
    write_index(tmp_path / "ingest", {FULL: "test"})
    architecture = {"backbone": "precomputed", "folder": str(tmp_path / "made")}
    save_encoder(tmp_path / "encoder", architecture, {})
    content = run(tmp_path)
    output = capsys.readouterr().out
    assert "warning" not in output
    shares = [100 * np.mean(np.stack(truth_cls)[[0, 1, 3, 4]] == number) for number in range(19)]
    road = f"road {shares[classes.ROAD]:.0f} %"
    height, width = street.SIZE
    assert f"{FULL}: 4 frames, as ingested: {width} × {height}, " in output
    assert f", {road}, " in output
    frames = [0, 1, 3, 4]
    assert content["frame"].tolist() == frames
    np.testing.assert_array_equal(content["cls"], [truth_cls[frame] for frame in frames])
    np.testing.assert_array_equal(content["depth_m"], [truth_depth[frame] for frame in frames])

    # This process has the first encoder open.
    architecture |= {"folder": f"{tmp_path}/later", "datasets": ["sample"]}
    save_encoder(tmp_path / "encoder", architecture, {})
    with pytest.raises(InputError, match="later"):
        run(tmp_path)
    warning = f"encoder was fitted to rendered streets alone: wrong depth on {FULL}"
    assert warning in capsys.readouterr().out


@pytest.mark.parametrize(
    ("columns", "factor"), [(slice(0, 200), 1), (slice(0, 200), 2), (slice(30, 110), 1)]
)
def test_precomputed_files_get_the_crop_of_the_image(tmp_path, columns, factor):
    """The image, depth and classes hold the column of the complete image, or of ingest's crop."""
    column = np.tile(np.arange(200), (40, 1))
    camera = Camera(np.array([[100, 0, 69.5], [0, 100, 19.5], [0, 0, 1]]), column.shape)
    image = np.repeat(column[..., None], 3, axis=-1).astype(np.uint8)
    drive = Drive(camera, lambda: iter([Frame(0, 0.0, image)]))
    settings = Reading(image_size=(32, 64), cameras=[2], lidar=False, on_damaged="fail")
    write_drive(tmp_path / "ingest.h5", drive, FULL, "kitti", settings)
    with open_ingest(tmp_path / "ingest.h5") as file:
        pixels = file["image"][0, ..., 0].astype(float)
        camera = read_camera(file)

    def write_and_read(made: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        write_png(tmp_path / f"{FULL}/depth/0000000000.png", (made * 256).astype(np.uint16))
        write_png(tmp_path / f"{FULL}/cls/0000000000.png", (made // 20).astype(np.uint8))
        return read_frame(tmp_path, FULL, 0, camera)

    made = column[:, columns].repeat(factor, axis=0).repeat(factor, axis=1)
    depth_m, cls = write_and_read(made)
    is_complete = columns == slice(0, 200)
    kind = "complete images, cropped as by stage ingest" if is_complete else "as ingested"
    text = f"{kind}: {made.shape[1]} × {made.shape[0]}"
    assert describe_sizes(tmp_path, FULL, 0, camera) == text
    assert np.abs(depth_m - pixels).max() <= 1
    assert np.abs(20 * cls + 10 - pixels).max() <= 11
    with pytest.raises(InputError, match="has 100 x 40 pixels, expected the aspect ratio of the i"):
        write_and_read(column[:, :100])
