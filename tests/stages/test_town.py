"""Stage town on drives of a few frames."""

from pathlib import Path

import pytest
import yaml

from pipeline import code
from pipeline.errors import InputError
from pipeline.kitti import find_drives
from stages import town

DRIVES = ["2026_01_01_drive_0001", "2026_01_01_drive_0002", "2026_01_03_drive_0001"]


def write_params(path: Path, source: str = "town", **settings: object) -> Path:
    params = yaml.safe_load((code.ROOT / "params.yaml").read_text(encoding="utf-8"))
    params["town"] |= {"image_size": [48, 160], "scan_rays": [16, 40], "frames": {"train": 2, "val": 1, "test": 3}}
    params["town"] |= settings
    params["ingest"] |= {"source": source, "drives": {"train": DRIVES[:2], "val": [], "test": DRIVES[2:]}}
    path.write_text(yaml.safe_dump(params), encoding="utf-8")
    return path


def test_drives_of_the_params_whatever_the_workers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = write_params(tmp_path / "params.yaml")
    outs = [tmp_path / "one", tmp_path / "two"]
    for workers, out in enumerate(outs, start=1):
        town.main(out=out, params=params, workers=workers)
    raw = find_drives(outs[0], DRIVES)
    assert [len(raw[drive].images(2)) for drive in DRIVES] == [2, 2, 3]
    assert raw[DRIVES[2]].camera([2]) is not None
    files = sorted(path.relative_to(outs[0]) for path in outs[0].rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(outs[1]) for path in outs[1].rglob("*") if path.is_file())
    assert Path("contact_sheet.png") in files
    for path in files:
        assert (outs[0] / path).read_bytes() == (outs[1] / path).read_bytes(), path
    assert "drive_0001: 2 frames" in capsys.readouterr().out


def test_a_second_run_replaces_the_first(tmp_path: Path) -> None:
    out = tmp_path / "town"
    town.main(out=out, params=write_params(tmp_path / "params.yaml"), workers=1)
    town.main(
        out=out, params=write_params(tmp_path / "params.yaml", frames={"train": 1, "val": 1, "test": 1}), workers=1
    )
    assert [len(drive.oxts) for drive in find_drives(out, DRIVES).values()] == [1, 1, 1]


def test_with_kitti_there_is_nothing_to_render(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    town.main(out=tmp_path / "town", params=write_params(tmp_path / "params.yaml", source="kitti"))
    assert list((tmp_path / "town").iterdir()) == []
    assert "ingest.source is kitti" in capsys.readouterr().out


@pytest.mark.parametrize("settings", [{"image_size": [0, 5]}, {"scan_rays": [0, 5]}, {"frames": {"train": 1}}])
def test_bad_settings_are_named(tmp_path: Path, settings: dict[str, object]) -> None:
    params = write_params(tmp_path / "params.yaml", **settings)
    with pytest.raises(InputError, match=f"town.{next(iter(settings))}"):
        town.main(out=tmp_path / "town", params=params)
    assert not (tmp_path / "town").exists()
