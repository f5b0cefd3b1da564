"""Stage sample on drives of a few frames."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pipeline.base import resume
from pipeline.base.errors import InputError
from pipeline.kitti.raw import find_drives
from pipeline.sample.drive import random_of, theme
from pipeline.sample.light import draw_ground_colours
from pipeline.sample.motion import draw_journey
from pipeline.sample.plan import draw_character, draw_plan
from pipeline.sample.route import IMU_LEFT_M, unit
from pipeline.sample.street import build_street
from pipeline.sample.world import World
from stages import sample

DRIVES = ["2026_01_01_drive_0001", "2026_01_01_drive_0002", "2026_01_11_drive_0001"]  # two dates, two cameras
KITTI = "2011_09_26_drive_0005"


def write_params(path: Path, source: str = "sample", val: tuple[str, ...] = (), **settings: Any) -> Path:
    params = yaml.safe_load((resume.ROOT / "params.yaml").read_text(encoding="utf-8"))
    params["sample"] |= {"image_size": [48, 160], "scan_rays": [16, 40], "frames": {"train": 2, "val": 1, "test": 3}}
    params["sample"] |= settings
    params["ingest"] |= {"source": source, "drives": {"train": DRIVES[:2], "val": list(val), "test": DRIVES[2:]}}
    path.write_text(yaml.safe_dump(params), encoding="utf-8")
    return path


@pytest.mark.parametrize("drive", ["2026_01_01_drive_0001", "2026_01_06_drive_0003"])
def test_ego_touches_nothing(drive: str) -> None:
    """In a tight right turn and a narrow street: the outline is on road, and rays from frame to frame hit nothing."""
    rng, (quarter, first) = random_of(drive, seed=0), theme(drive)
    character = draw_character(rng, quarter)
    journey = draw_journey(rng, 60, character, first)
    plan = draw_plan(journey.route, rng, character)
    world = World(plan, build_street(journey.route, plan, character, rng), draw_ground_colours(rng))
    ahead, left = unit(journey.heading_rad), unit(journey.heading_rad + np.pi / 2)
    for forward, aside in product((-0.8, 1.3, 3.5), (-0.85, 0.0, 0.85)):  # from the centre of the rear axle
        places = journey.xy + forward * ahead + (aside - IMU_LEFT_M) * left
        assert (plan.to_road_m[plan.cells(*places.T)] == 0).all()
        steps = np.diff(places, axis=0)
        length = np.linalg.norm(steps, axis=1)
        for height in (0.4, 1.5):
            starts = np.column_stack([places[:-1], np.full(len(steps), height)])
            rays = np.column_stack([starts, steps / length[:, None], np.zeros(len(steps))]).astype(np.float32)
            assert (world.cast(rays.T).distance_m > length).all()


def test_drives_of_the_params(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """KITTI's drives are left out; a second run with other settings replaces the first."""
    params = write_params(tmp_path / "params.yaml", source="both", val=(KITTI,))
    kitti = tmp_path / "raw" / KITTI[:10] / f"{KITTI}_sync"
    kitti.mkdir(parents=True)
    out = sample.main(out=tmp_path / "sample", params=params, raw=tmp_path / "raw", workers=1)
    raw = find_drives(out, DRIVES)
    assert [len(raw[drive].images(2)) for drive in DRIVES] == [2, 2, 3]
    focal = [raw[drive].camera(2).K[0, 0] for drive in DRIVES]
    assert focal[0] == focal[1] < focal[2]
    assert sorted(path.name for path in out.glob("*/*_sync")) == [f"{drive}_sync" for drive in DRIVES]
    assert "drive_0001: 2 frames" in capsys.readouterr().out
    sample.main(out=out, params=write_params(params, frames={"train": 1, "val": 1, "test": 1}), workers=1)
    assert [len(drive.images(2)) for drive in find_drives(out, DRIVES).values()] == [1, 1, 1]


def test_a_missing_real_drive_is_an_error_before_rendering(tmp_path: Path) -> None:
    params = write_params(tmp_path / "params.yaml", source="both", val=(KITTI,))
    (tmp_path / "raw/2011_09_26/2011_09_26_drive_0001_sync").mkdir(parents=True)
    with pytest.raises(InputError, match=f"drive {KITTI} of ingest.drives is missing"):
        sample.main(out=tmp_path / "sample", params=params, raw=tmp_path / "raw")
    assert not (tmp_path / "sample").exists()
