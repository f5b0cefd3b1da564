"""Stages clouds and graphs, one after the other: what the one writes is what the other reads."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import pool, store
from pipeline.base.errors import InputError
from pipeline.camera import classes, geometry
from pipeline.camera.images import DEPTH_UNITS_PER_M
from pipeline.graphs import cloud
from pipeline.kitti.ingest_file import put_motion, put_pixels
from pipeline.kitti.oxts import make_rows
from pipeline.motion import kinds
from stages import clouds, graphs
from tests import street

PARAMS = Path(__file__).resolve().parents[2] / "params.yaml"
SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_03_drive_0001": "test"}
FULL, BLIND, CAMERA = SPLITS


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ingest and perception of a drive with everything, one without images, one without LiDAR; then clouds."""
    folder = tmp_path_factory.mktemp("data")
    street.write_drive(folder / "ingest", FULL, 4, lidar=True)
    street.write_drive(folder / "ingest", BLIND, 3, lidar=True, images=False, dense=False)
    street.write_drive(folder / "ingest", CAMERA, 3)
    for drive in SPLITS:
        street.write_perception(folder / "perception", folder / "ingest", drive)
    store.write_index(folder / "ingest", SPLITS)
    store.write_index(folder / "perception", SPLITS)
    _params(folder / "params.yaml")
    _clouds(folder, folder / "clouds", folder / "params.yaml")
    kinds.write(folder / "motion", [])
    return folder


def _params(path: Path, **changes: dict[str, object]) -> Path:
    content = yaml.safe_load(PARAMS.read_text())
    for section, values in changes.items():
        content[section] = {**content[section], **values}
    path.write_text(yaml.safe_dump(content))
    return path


def _clouds(data: Path, out: Path, params: Path) -> None:
    assert clouds.main(data / "ingest", data / "perception", out, params, workers=1) == out


def _graphs(data: Path, out: Path, variant: str, params: Path | None = None) -> Path:
    folder = graphs.main(variant, data, out, params or data / "params.yaml", workers=1)
    assert folder == out / variant
    return folder


def test_pseudo_clouds_are_the_pixels_in_space(data: Path) -> None:
    with store.DriveReader(data / f"clouds/pseudo/{FULL}.h5", stage="clouds") as file:
        ptr, xyz, cls = file["ptr"], file["xyz"], file["cls"]
        assert file.frame.tolist() == [0, 1, 2, 3]
    for frame in range(4):
        _, depth, truth = street.scene(frame)
        points, labels = xyz[ptr[frame] : ptr[frame + 1]], cls[ptr[frame] : ptr[frame + 1]]
        assert len(points) == (depth > 0).sum()
        uv, z = geometry.project(points.astype(np.float64), street.K)
        u, v = np.rint(uv).astype(int).T
        assert z == pytest.approx(depth[v, u], abs=0.5 / DEPTH_UNITS_PER_M + 0.001)
        assert (labels == truth[v, u]).all()
        assert (cloud.morton_order(points) == np.arange(len(points))).all()


def test_lidar_clouds_are_in_the_camera_frame(data: Path) -> None:
    with (
        store.DriveReader(data / f"clouds/lidar/{FULL}.h5", stage="clouds") as file,
        store.DriveReader(data / f"ingest/{FULL}.h5", stage="ingest") as raw,
    ):
        a, b = raw["lidar_ptr"][1:3]
        points = geometry.transform(raw["T_cam_velo"], raw["lidar"][a:b, :3].astype(np.float64))
        c, d = file["ptr"][1:3]
        assert np.abs(np.sort(file["xyz"][c:d], axis=0) - np.sort(points, axis=0)).max() < 0.001
        assert {classes.ROAD, classes.BUILDING} <= set(file["cls"][c:d].tolist())


def test_drives_without_a_modality_give_empty_files(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for kind, drive in (("pseudo", BLIND), ("lidar", CAMERA)):
        assert store.read_index(data / "clouds" / kind, stage="clouds") == SPLITS
        with store.DriveReader(data / f"clouds/{kind}/{drive}.h5", stage="clouds") as file:
            assert file.shape("frame") == (0,)
            assert file.shape("xyz") == (0, 3)
            assert file["ptr"].tolist() == [0]
    with store.DriveReader(data / f"clouds/lidar/{BLIND}.h5", stage="clouds") as file:
        assert len(file["xyz"]) > 0
        assert (file["cls"] == classes.VOID).all()  # no image, no class
    made = _graphs(data, data / "graphs", "depth")
    with store.DriveReader(made / f"{BLIND}.h5", stage="graphs") as file:
        assert file.shape("xyz") == (0, 3)
        assert file["indices_ptr"].tolist() == [0]


def test_max_points_bounds_each_frame(data: Path, tmp_path: Path) -> None:
    params = _params(tmp_path / "params.yaml", clouds={"max_points": 50, "max_depth_m": 20.0})
    _clouds(data, tmp_path / "clouds", params)
    with store.DriveReader(tmp_path / f"clouds/pseudo/{FULL}.h5", stage="clouds") as file:
        assert np.diff(file["ptr"]).tolist() == [50] * 4
        assert file["xyz"][:, 2].max() <= 20.0


def test_graphs_hold_what_the_variant_says(data: Path, tmp_path: Path) -> None:
    variants = {
        "semantic": {"source": "clouds/pseudo", "points": 300, "k": 6, "keep_inter_class": 0.2},
        "depth": {"source": "clouds/pseudo", "points": 300, "k": 6},
    }
    params = _params(tmp_path / "params.yaml", graphs=variants)
    read = {}
    for name in variants:
        made = _graphs(data, tmp_path, name, params)
        with store.DriveReader(made / f"{FULL}.h5", stage="graphs") as file:
            read[name] = {key: file[key] for key in ("ptr", "xyz", "cls", "degree", "edges_knn", "edges_kept")}
            assert file["indices_ptr"][-1] == len(file["indices"]) == file["degree"].sum(dtype=np.int64)
            assert file["indices"].dtype == np.uint16
    for columns in read.values():
        assert np.diff(columns["ptr"]).tolist() == [300] * 4
        assert (columns["edges_knn"] == 300 * 6).all()
    # The same points, fewer edges between classes.
    assert (read["semantic"]["xyz"] == read["depth"]["xyz"]).all()
    assert (read["depth"]["edges_kept"] == read["depth"]["edges_knn"]).all()
    assert (read["semantic"]["edges_kept"] < read["depth"]["edges_kept"]).all()


def test_a_crop_keeps_what_lies_in_it(data: Path, tmp_path: Path) -> None:
    crop = [-6.0, 4.0, 5.0, 12.0]
    whole = {"source": "clouds/lidar", "points": 10**6, "k": 6}
    params = _params(tmp_path / "params.yaml", graphs={"whole": whole, "near": {**whole, "crop_m": crop}})
    xyz, ptr = {}, {}
    for name in ("whole", "near"):
        with store.DriveReader(_graphs(data, tmp_path, name, params) / f"{FULL}.h5", stage="graphs") as file:
            xyz[name], ptr[name] = file["xyz"], file["ptr"]
    x, _, z = xyz["whole"].T
    inside = (crop[0] <= x) & (x <= crop[2]) & (crop[1] <= z) & (z <= crop[3])
    assert 0 < inside.sum() < len(x)
    np.testing.assert_array_equal(xyz["near"], xyz["whole"][inside])
    assert ptr["near"].tolist() == [0, *np.cumsum(inside)[ptr["whole"][1:] - 1]]


def test_a_crop_without_a_point_gives_an_empty_frame(data: Path, tmp_path: Path) -> None:
    beside = {"source": "clouds/lidar", "points": 100, "k": 6, "crop_m": [5, 0, 10, 60]}  # between walls that come near
    params = _params(tmp_path / "params.yaml", graphs={"beside": beside})
    with store.DriveReader(_graphs(data, tmp_path, "beside", params) / f"{FULL}.h5", stage="graphs") as file:
        assert (np.diff(file["ptr"]) > 0).tolist() == [False, True, True, False]


SETS = {
    "source": "clouds/pseudo", "points": 300, "neighbourhood": "pointnet2", "centres": [20, 6], "radius_m": [4, 9],
    "neighbours": [8, 5],
}  # fmt: skip


@pytest.mark.parametrize("more", [{"k": 6, "source": "clouds/lidar"}, SETS], ids=["lidar", "sets"])
def test_what_leaves_no_point_in_any_frame_is_refused(data: Path, tmp_path: Path, more: dict[str, object]) -> None:
    params = _params(tmp_path / "params.yaml", graphs={"far": {"points": 100, **more, "crop_m": [900, 900, 901, 901]}})
    message = r"params\.yaml: graphs\.far: no point in any of the \d frames of the train drives\. Widen crop_m = \[900"
    with pytest.raises(InputError, match=message):
        _graphs(data, tmp_path, "far", params)
    assert not (tmp_path / "far/index.json").exists()  # so that nobody trains on it


def test_depths_that_leave_no_point_in_any_frame_are_refused(data: Path, tmp_path: Path) -> None:
    params = _params(tmp_path / "params.yaml", clouds={"max_depth_m": 0.5})
    message = r"clouds/pseudo: no point in any of the 4 frames of the train drives\. Raise clouds\.max_depth_m = 0\.5"
    with pytest.raises(InputError, match=message):
        _clouds(data, tmp_path / "clouds", params)


def test_pointnet2_neighbours_lie_in_the_balls_of_the_variant(data: Path, tmp_path: Path) -> None:
    variants = {"sets": SETS, "depth": {"source": "clouds/pseudo", "points": 300, "k": 6}}
    params = _params(tmp_path / "params.yaml", graphs=variants)
    with store.DriveReader(_graphs(data, tmp_path, "depth", params) / f"{FULL}.h5", stage="graphs") as file:
        xyz = file["xyz"]
    with store.DriveReader(_graphs(data, tmp_path, "sets", params) / f"{FULL}.h5", stage="graphs") as file:
        assert (file["xyz"] == xyz).all()  # the same points as of a graph
        assert np.diff(file["centres_1_ptr"]).tolist() == [20] * 4
        assert np.diff(file["centres_2_ptr"]).tolist() == [6] * 4
        assert (file.shape("neighbours_1"), file.shape("neighbours_2")) == ((80, 8), (24, 5))
        assert file["neighbours_1"].dtype == np.uint16
        for frame in range(4):
            points = xyz[frame * 300 :][:300]
            for number, count, radius_m in ((1, 20, 4), (2, 6, 9)):
                rows = slice(frame * count, (frame + 1) * count)
                centres = points[file[f"centres_{number}"][rows]]
                offset = points[file[f"neighbours_{number}"][rows]] - centres[:, None]
                assert np.linalg.norm(offset, axis=2).max() <= radius_m
                assert len(np.unique(file[f"centres_{number}"][rows])) == count
                points = centres
    made = _graphs(data, tmp_path, "sets", params)
    with store.DriveReader(made / f"{BLIND}.h5", stage="graphs") as file:
        assert file.shape("neighbours_1") == (0, 8)
        assert file["centres_2_ptr"].tolist() == [0]


def test_images_are_ingests_frame_by_frame(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ingest").mkdir()
    for path in (data / "ingest").iterdir():
        shutil.copyfile(path, tmp_path / "ingest" / path.name)
    with store.DriveWriter(tmp_path / f"ingest/{FULL}.h5", stage="ingest", drive=FULL, params={}) as file:
        with store.DriveReader(data / f"ingest/{FULL}.h5", stage="ingest") as raw:
            image, time_s = raw["image"], raw["time_s"]
        put_motion(file, np.array([3, 4, 6, 9]), time_s, make_rows(4))
        put_pixels(file, "image", 4, street.SIZE, [(row, image[row]) for row in (0, 2, 3)])
    params = _params(tmp_path / "params.yaml", graphs={"image": {"source": "ingest"}})
    kinds.write(tmp_path / "motion", [])
    _graphs(tmp_path, tmp_path / "graphs", "image", params)  # no clouds, no perception are there
    assert f"image: no frames in {BLIND}" in capsys.readouterr().out
    with store.DriveReader(tmp_path / f"graphs/image/{FULL}.h5", stage="graphs") as file:
        assert file.frame.tolist() == [3, 6, 9]
        assert (file.time_s == time_s[[0, 2, 3]]).all()
        assert (file["image"] == image[[0, 2, 3]]).all()
    with store.DriveReader(tmp_path / f"graphs/image/{BLIND}.h5", stage="graphs") as file:
        assert file.shape("image") == (0, *street.SIZE, 3)
    assert store.read_index(tmp_path / "graphs/image", stage="graphs") == SPLITS


@pytest.mark.slow
def test_neither_workers_nor_blocks_change_a_byte(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spanning = {"source": "clouds/pseudo", "points": 300, "k": 4, "accumulate": {"motion": "visual", "frames": 3}}
    params = _params(tmp_path / "params.yaml", graphs={"sets": SETS, "spanning": spanning})
    write_motion(tmp_path / "motion" / "visual", valid=[0, 1, 1, 1])
    contents = []
    for name, workers, size in (("a", 1, 32), ("b", 2, 1), ("c", 3, 3)):
        monkeypatch.setattr(pool, "BLOCK_FRAMES", size)
        out = tmp_path / name
        out.mkdir()
        (out / "ingest").symlink_to(data / "ingest")
        (out / "motion").symlink_to(tmp_path / "motion")
        clouds.main(data / "ingest", data / "perception", out / "clouds", data / "params.yaml", workers)
        for variant in ("semantic", "sets", "image", "spanning"):
            graphs.main(variant, out, out / "graphs", params, workers)
        contents.append({str(path.relative_to(out)): path.read_bytes() for path in sorted(out.glob("[cg]*/*/*.*"))})
    assert len(contents[0]) == 2 * 4 + 4 * 4
    assert contents[0] == contents[1] == contents[2]


def test_unknown_variants_and_foreign_files_are_one_line(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"graphs has no 'semantics': did you mean semantic\?"):
        _graphs(data, tmp_path, "semantics")
    (tmp_path / "clouds").mkdir()
    kinds.write(tmp_path / "motion", [])
    shutil.copytree(data / "ingest", tmp_path / "clouds/pseudo")
    with pytest.raises(InputError, match=r"stage 'ingest'.* stage 'clouds'"):
        _graphs(tmp_path, tmp_path / "graphs", "depth", data / "params.yaml")
    (tmp_path / f"clouds/pseudo/{BLIND}.h5").unlink()
    with pytest.raises(InputError, match=rf"lacks {BLIND}.* dvc pull clouds"):
        _graphs(tmp_path, tmp_path / "graphs", "depth", data / "params.yaml")


def test_an_accumulated_cloud_is_that_of_several_frames(data: Path, tmp_path: Path) -> None:
    for name in ("clouds", "ingest", "perception"):
        (tmp_path / name).symlink_to(data / name)
    write_motion(tmp_path / "motion" / "visual", valid=[0, 1, 1, 0])
    lines = {
        name: {"source": "clouds/pseudo", "points": 300, "k": 4, "crop_m": [-20, -3, 20, 30], "accumulate": settings}
        for name, settings in {
            "one": None, "three": {"motion": "visual", "frames": 3}
        }.items()
    }  # fmt: skip
    lines["lidar"] = lines["three"] | {"source": "clouds/lidar", "accumulate": {"motion": "lidar", "frames": 3}}
    params = _params(tmp_path / "params.yaml", graphs=lines)
    one, three = (_graphs(tmp_path, tmp_path / "graphs", name, params) for name in ("one", "three"))
    with (
        store.DriveReader(one / f"{FULL}.h5", stage="graphs") as single,
        store.DriveReader(three / f"{FULL}.h5", stage="graphs") as file,
    ):
        xyz, ptr = file["xyz"], file["ptr"]
        assert (np.diff(ptr) == 300).all()
        assert (file["visual_valid"] == [0, 1, 1, 0]).all()
        of_frames = [xyz[a:b] for a, b in pairwise(ptr)]
        for points in of_frames:
            assert (cloud.morton_order(points) == np.arange(300)).all()
            assert (points[:, 2] >= -3).all()
            assert (points[:, 2] <= 30).all()
        own = single["xyz"][: single["ptr"][1]]
        assert (of_frames[0] == own).all()  # the first frame has nothing before it
        nearest = [points[:, 2].min() for points in of_frames]
        assert nearest[2] < nearest[0] - 1.5  # two metres since the first frame
        assert nearest[3] > nearest[2] + 1  # motion that was not measured
    with pytest.raises(InputError, match=r"graphs\.lidar\.accumulate\.motion = 'lidar', but .*motion holds visual: "):
        graphs.main("lidar", tmp_path, tmp_path / "graphs", params, workers=1)


def write_motion(folder: Path, valid: list[int]) -> None:
    """Write the motion of a car that goes straight, a metre a frame."""
    T_before = np.tile(np.eye(4, dtype=np.float32), (len(valid), 1, 1))
    T_before[:, 2, 3] = valid
    for drive in SPLITS:
        with store.DriveWriter(folder / f"{drive}.h5", stage="motion", drive=drive, params={}) as file:
            file.put("frame", np.arange(len(valid), dtype=np.int32))
            file.put("time_s", np.arange(len(valid)) / 10)
            file.put("valid", np.array(valid, np.uint8))
            file.put("yaw_rate_radps", np.zeros(len(valid), np.float32))
            file.put("speed_mps", np.array(valid, np.float32) * 10)
            file.put("T_before", T_before)
            file.put("scale", np.ones(len(valid), np.float32))
    store.write_index(folder, SPLITS)
    kinds.write(folder.parent, [folder.name])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ({"source": "ingest", "accumulate": {"motion": "visual", "frames": 3}}, "accumulate means nothing to images"),
        ({"accumulate": {"motion": "visual", "frames": 1}}, r"accumulate\.frames = 1: .*greater than or equal to 2"),
        ({"accumulate": {"motion": "oxts", "frames": 3}}, r"accumulate\.motion = 'oxts': .*visual.*lidar"),
        ({"accumulate": {"motion": "lidar", "frames": 3}}, r"accumulate\.motion = 'lidar' is in metres.*take visual"),
        ({"accumulate": {"frames": 3}}, r"accumulate\.motion is missing"),
        ({"accumulate": {"motion": "visual", "frame": 3}}, r"unknown key graphs\.v\.accumulate\.frame: .*frames"),
    ],
)
def test_what_accumulate_cannot_be_is_refused(tmp_path: Path, line: dict[str, object], message: str) -> None:
    points = {"points": 300, "k": 4} if "source" not in line else {}
    params = _params(tmp_path / "params.yaml", graphs={"v": {"source": "clouds/pseudo"} | points | line})
    with pytest.raises(InputError, match=message):
        graphs.main("v", tmp_path, tmp_path / "graphs", params, workers=1)


def test_each_kind_of_measured_motion_is_carried_by_points_and_images(tmp_path: Path, data: Path) -> None:
    for folder in ("clouds", "ingest"):
        (tmp_path / folder).symlink_to(data / folder)
    for drive in SPLITS:
        with store.DriveWriter(tmp_path / f"motion/visual/{drive}.h5", stage="motion", drive=drive, params={}) as file:
            file.put("frame", np.array([1, 3], np.int32))
            file.put("yaw_rate_radps", np.array([0.1, 0.3], np.float32))
            file.put("speed_mps", np.array([1, 3], np.float32))
            file.put("valid", np.array([0, 1], np.uint8))
    store.write_index(tmp_path / "motion/visual", SPLITS)
    kinds.write(tmp_path / "motion", ["visual"])
    params = _params(tmp_path / "params.yaml", graphs={"image": {"source": "ingest"}})
    for variant in ("depth", "image"):
        path = _graphs(tmp_path, tmp_path / "graphs", variant, params) / f"{FULL}.h5"
        with store.DriveReader(path, stage="graphs") as file:
            assert file["visual_speed_mps"].tolist() == [0, 1, 0, 3]
            assert file["visual_valid"].tolist() == [0, 0, 0, 1]
            assert "lidar_valid" not in file
