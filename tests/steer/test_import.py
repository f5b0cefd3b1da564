"""steer import: drives and a preset of a recording, or it is refused; what it replaces."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import yaml

from footage import convert
from pipeline.base.errors import InputError
from pipeline.check import preset
from pipeline.ingest.datasets.kitti import IMPORT
from pipeline.ingest.ingest_file import open_ingest
from stages import check, ingest
from stages.preset import Params, hash_imports, merge_preset
from steer.commands.import_ import import_recording
from tests.kitti_drive import SIZE, contents, pictures, write, write_video

FRAMES = 200
HEAD = "time_s,speed_mps,yaw_rate_radps\n"
STEADY = HEAD + "".join(f"{half / 2},5,{half / 600}\n" for half in range(-2, 60))
WHEEL = "time_s,wheel_rad\n" + "".join(f"{half / 2},1.0\n" for half in range(-2, 60))


@pytest.fixture
def take(tmp_path, monkeypatch) -> Callable[..., dict[str, Any]]:
    """Return a function that imports a recording to an empty presets/ and returns the preset.

    The field of view is 80 degrees. Logs are given as text.
    """
    (tmp_path / "presets").mkdir()
    monkeypatch.setattr(preset, "PRESETS", tmp_path / "presets")

    def imported(recording: Path, name: str = "monday", **options: Any) -> dict[str, Any]:
        for log in {"motion", "wheel"} & {*options}:
            write(tmp_path / f"{log}.txt", options[log])
            options[log] = tmp_path / f"{log}.txt"
        if "wheel" in options:
            options.setdefault("steering_ratio", 10.0)
        import_recording([recording], **{"name": name, "fov_deg": 80.0, **options})
        return merge_preset(str(tmp_path / f"presets/{name}"))

    return imported


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Write a video of 20 s, 10 images per second."""
    path = tmp_path_factory.mktemp("video") / "drive.mp4"
    return write_video(path, np.resize(pictures(12), (FRAMES, *SIZE, 3)))


def test_an_import_is_repeated_and_nothing_else_is_replaced(tmp_path, take, video):
    """An import with another log has another hash, by which make NAME notices it."""
    raw = tmp_path / "data/raw"
    preset_path = tmp_path / "presets/monday.yaml"
    settings = Params.model_validate(take(video)).ingest
    first = preset_path.read_text(), hash_imports(settings, raw)
    take(video, motion=STEADY)
    assert (raw / "monday/monday_drive_0001_sync/motion.csv").is_file()
    second = preset_path.read_text()
    assert second != first[0]
    assert hash_imports(settings, raw) != first[1]
    record = json.loads((raw / "monday" / IMPORT).read_text())
    assert record["recordings"] == [{"name": "drive.mp4", "bytes": video.stat().st_size}]

    other = tmp_path / "next/drive.mp4"
    write(other, video.read_bytes() + b"\0\0\0\x08free")
    with pytest.raises(InputError, match=r"is an import of another recording, drive.mp4"):
        take(other)
    preset_path.write_text(second + "# mine\n")
    with pytest.raises(InputError, match=r"monday.yaml: was edited since the import"):
        take(video)
    preset_path.write_text(second)
    values = raw / "monday/monday_drive_0002_sync/motion.csv"
    logged = values.read_text()
    values.write_text(f"{logged}99,5,0\n")
    with pytest.raises(InputError, match=r"0002_sync/motion.csv: was edited since the import"):
        take(video)
    values.write_text(logged)
    write(raw / "monday/notes.txt", "mine")
    with pytest.raises(InputError, match=r"notes.txt: is not by the import"):
        take(video)
    write(raw / "kitti/a.txt", "mine")
    with pytest.raises(InputError, match=r"kitti: exists already and holds a\.txt"):
        take(video, name="kitti")


@pytest.mark.parametrize(
    ("labels_by", "options", "base", "horizon"),
    [
        (("motion", "computed"), {}, "motion", 10),
        (("ingest", "computed"), {"motion": STEADY}, "motion", 0),
        (("motion", "recorded"), {"wheel": WHEEL}, "none", 0),
        (("ingest", "recorded"), {"motion": STEADY, "wheel": WHEEL}, "none", 0),
    ],
)
def test_the_preset_is_one_that_check_accepts_and_ingest_reads(
    tmp_path, take, video, monkeypatch, labels_by, options, base, horizon
):
    content = take(video, camera_height_m=1.4, **options)
    assert list(content["models"]) == ["motion", "scene"]
    settings = Params.model_validate(content)
    assert (settings.labels.source, settings.labels.angle) == labels_by
    drives = {"monday_drive_0001": "train", "monday_drive_0002": "val", "monday_drive_0003": "test"}
    assert settings.ingest.drives.splits() == drives
    assert settings.models["motion"].base == base
    assert settings.models["motion"].horizon == horizon
    for model in settings.models.values():
        check.check_model(model, settings)

    monkeypatch.chdir(tmp_path)
    content["ingest"]["image_size"] = [48, 64]
    Path("params.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(content))))
    out = ingest.main()
    for drive, frames in zip(drives, (100, 20, 40), strict=True):
        with open_ingest(out / f"{drive}.h5") as file:
            assert len(file.frame) == frames
            assert file.params["camera_height_m"] == 1.4
            assert ("speed_mps" in file) == ("motion" in options)
            assert ("steering_rad" in file) == ("wheel" in options)
            if "wheel" in options:
                np.testing.assert_allclose(file["steering_rad"], 0.1)


def test_a_full_disk_leaves_nothing_half(tmp_path, take, video, monkeypatch):
    error = OSError(28, "No space left on device")
    monkeypatch.setattr(convert, "write_calibration", Mock(side_effect=error))
    with pytest.raises(OSError, match=r"No space left on device: '.*/data/raw/monday'"):
        take(video)
    assert [*(tmp_path / "data/raw").iterdir()] == [*(tmp_path / "presets").iterdir()] == []


PLAINLY_WRONG = [
    ({"fov_deg": None}, "--fov DEGREES"),
    ({"name": "a b"}, "--name: expected letters"),
    ({"name": "street"}, "street: is a target of make"),
    ({"name": "index"}, "index: is the name of a file that stage report writes"),
    ({"motion": HEAD + "19.5,5,0\n19.9,5,0\n"}, "0001_sync has no image with a known speed_mps"),
    ({"split": "60,20,30"}, "with the sum 100"),
    ({"motion": "time_s,speed\n"}, "motion.txt: has no column speed_mps"),
]


@pytest.mark.parametrize(("options", "problem"), PLAINLY_WRONG)
def test_plainly_wrong_imports_write_nothing(tmp_path, take, video, options, problem):
    with pytest.raises(InputError, match=problem):
        take(video, **options)
    assert [name for name in contents(tmp_path) if name.startswith("presets")] == []
    assert not (tmp_path / "data/raw/monday").exists()
