"""params.yaml stands as DVC writes it: what ``dvc exp run -S`` changes is one line of it."""

import re
from pathlib import Path

import pytest
import yaml
from dvc.utils.hydra import apply_overrides

from pipeline.sections import preset

MODEL = "models.sa-gnn-ncp"
WAITING = re.compile(r"^# (?=[\w-]+: \{)", re.MULTILINE)  # a model's line that is a comment


def changed_lines(before: str, path: Path, *overrides: str) -> list[tuple[str, str]]:
    """Return the lines that differ, as they were and are, after what ``dvc exp run -S`` does with the file."""
    path.write_text(before)
    apply_overrides(path, list(overrides))
    pairs = zip(before.splitlines(), path.read_text().splitlines(), strict=True)
    return [(old, new) for old, new in pairs if old != new]


@pytest.mark.parametrize(
    ("override", "line"),
    [
        (f"{MODEL}.temporal=lstm", "temporal: lstm"),
        (f"{MODEL}.semantics=0.5", "semantics: 0.5"),
        ("graphs.semantic.points=2000", "points: 2000"),
        ("graphs.lidar.crop_m=[-20,-10,20,30]", "crop_m: [-20, -10, 20, 30]"),
        ("graphs.lidar-pointnet2.centres=[256,32]", "- 256"),
        ("train.seeds=[7]", "- 7"),
        ("train.epochs=20", "epochs: 20"),
        ("town.frames.test=70", "test: 70"),
        ("town.replay=data/raw", "replay: data/raw"),
        ("encoder.weights=a.pt", "weights: a.pt"),
        ("encoder.frozen=true", "frozen: true"),
    ],
)
def test_a_changed_value_is_a_changed_line(tmp_path: Path, override: str, line: str) -> None:
    ((old, new),) = changed_lines(preset.PARAMS.read_text(), tmp_path / "params.yaml", override)
    assert line in new
    assert line not in old
    comment = re.compile("# .*")
    assert comment.findall(old) == comment.findall(new)


@pytest.mark.parametrize("name", [path.stem for path in preset.PRESETS.glob("*.yaml")])
def test_so_is_it_with_a_preset_laid_over(tmp_path: Path, name: str) -> None:
    ((_, new),) = changed_lines(preset.text(name), tmp_path / "params.yaml", f"{MODEL}.temporal=lstm")
    assert "temporal: lstm" in new


def test_a_key_that_comes_or_goes_costs_no_comment(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(preset.PARAMS.read_text())
    comments = re.findall(r"^ *#.*", path.read_text(), re.MULTILINE)
    apply_overrides(path, [f"+{MODEL}.cell=cfc", f"~{MODEL}.semantics"])
    assert re.findall(r"^ *#.*", path.read_text(), re.MULTILINE) == comments
    assert yaml.safe_load(path.read_text())["models"]["sa-gnn-ncp"].items() >= {"cell": "cfc", "window": 8}.items()


def test_models_that_wait_as_comments_are_those_of_table2() -> None:
    content = yaml.safe_load(WAITING.sub("  ", preset.PARAMS.read_text()))
    models = preset.merged("table2")["models"]
    assert len(content["models"]) == 9
    assert content["models"] == {name: models[name] for name in content["models"]}
