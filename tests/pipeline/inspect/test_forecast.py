"""The forecast follows params.yaml, and agrees with what was measured of whole runs."""

from pathlib import Path

import pytest
import yaml

from pipeline.base import resume
from pipeline.inspect.forecast import Forecast, forecast, free_bytes, present_bytes
from pipeline.sections import preset

PARAMS = resume.ROOT / "params.yaml"


def changed(tmp_path: Path, **changes: object) -> Path:
    """Return params.yaml with single values changed: section__key=value."""
    content = yaml.safe_load(PARAMS.read_text())
    for place, value in changes.items():
        section, key = place.split("__")
        content[section][key] = value
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_the_sample_is_near_what_was_measured() -> None:
    made = forecast(PARAMS, {}, 0)
    assert 2 < made.hours(made.seconds, cores=2) * 60 / 8 * 2 < 8  # README: 8 minutes on 2 cores, within a factor of 2
    assert sum(made.bytes.values()) == pytest.approx(2.7e9, rel=0.3)  # data/README.md


def test_kitti_is_near_what_was_measured(tmp_path: Path) -> None:
    params = tmp_path / "params.yaml"
    params.write_text(preset.text("kitti", PARAMS))
    drives = yaml.safe_load(params.read_text())["ingest"]["drives"]
    names = [drive for split in drives.values() for drive in split]
    made = forecast(params, dict.fromkeys(names, round(27_634 / len(names))), 120_000)
    table = {"ingest": 47e9, "perception": 5.0e9, "clouds": 16e9, "graphs@semantic": 16e9}  # data/README.md
    for stage, size in table.items():
        assert made.bytes[stage] == pytest.approx(size, rel=0.15), stage
    assert made.bytes["town"] == made.seconds["town"] == 0


def test_more_of_what_costs_costs_more(tmp_path: Path) -> None:
    def of(**changes: object) -> Forecast:
        return forecast(changed(tmp_path, **changes), {}, 0)

    base = of()
    assert of(train__epochs=48).seconds["train@sa-gnn-ncp"] == pytest.approx(2 * base.seconds["train@sa-gnn-ncp"])
    assert of(train__seeds=[0, 1, 2]).seconds["train@sa-gnn-ncp"] == pytest.approx(3 * base.seconds["train@sa-gnn-ncp"])
    assert of(clouds__max_points=24_000).bytes["clouds"] == pytest.approx(2 * base.bytes["clouds"])
    assert of(ingest__lidar=False).bytes["clouds"] == pytest.approx(base.bytes["clouds"] / 2)
    assert of(motion__kinds=["visual", "lidar"]).seconds["motion"] > base.seconds["motion"]
    assert base.hours(["ingest"], cores=4) < base.hours(["ingest"], cores=1)
    assert base.hours(["train@sa-gnn-ncp"], cores=4) == base.hours(["train@sa-gnn-ncp"], cores=1)
    assert base.hours(["unknown"], cores=1) == 0


def test_images_have_no_points(tmp_path: Path) -> None:
    model = {"input": "image", "spatial": "cnn", "temporal": "ncp", "window": 16}
    made = forecast(changed(tmp_path, models__cnn=model), {}, 0)
    assert made.bytes["graphs@image"] > made.bytes["graphs@semantic"]
    assert made.seconds["train@cnn"] > 0


def test_disks(tmp_path: Path) -> None:
    (tmp_path / "graphs/semantic").mkdir(parents=True)
    (tmp_path / "graphs/semantic/a.h5").write_bytes(bytes(1000))
    assert present_bytes(tmp_path, ["graphs@semantic", "train@a"]) == 1000
    assert free_bytes(tmp_path) > 0
