"""params.yaml has the format that DVC writes, so that ``dvc exp run -S`` changes one line."""

import re
from pathlib import Path

import pytest
import yaml
from dvc.utils.hydra import apply_overrides

from pipeline.sections import preset

MODEL = "models.sa-gnn-ncp"
COMMENTED = re.compile(r"^# (?=[\w-]+: \{)", re.MULTILINE)  # an entry of graphs or models


def changed_lines(before: str, path: Path, *overrides: str) -> list[tuple[str, str]]:
    """Return the lines that ``dvc exp run -S`` changes, before and after."""
    path.write_text(before)
    apply_overrides(path, list(overrides))
    pairs = zip(before.splitlines(), path.read_text().splitlines(), strict=True)
    return [(old, new) for old, new in pairs if old != new]


@pytest.mark.parametrize(
    ("override", "line"),
    [
        (f"{MODEL}.temporal=lstm", "temporal: lstm"),
        ("train.seeds=[7]", "- 7"),
        ("encoder.weights=a.pt", "weights: a.pt"),
    ],
)
def test_a_changed_value_is_a_changed_line(tmp_path: Path, override: str, line: str) -> None:
    ((old, new),) = changed_lines(preset.PARAMS.read_text(), tmp_path / "params.yaml", override)
    assert line in new
    assert line not in old
    comment = re.compile("# .*")
    assert comment.findall(old) == comment.findall(new)


@pytest.mark.parametrize("name", [path.stem for path in preset.PRESETS.glob("*.yaml")])
def test_a_preset_keeps_the_format(tmp_path: Path, name: str) -> None:
    ((_, new),) = changed_lines(preset.text(name), tmp_path / "params.yaml", f"{MODEL}.temporal=lstm")
    assert "temporal: lstm" in new


def test_commented_variants_and_models_are_those_of_table2() -> None:
    content = yaml.safe_load(COMMENTED.sub("  ", preset.PARAMS.read_text()))
    table2 = preset.merged("table2")
    assert (len(content["models"]), len(content["graphs"])) == (9, 6)
    assert content["models"].items() <= table2["models"].items()
    assert content["graphs"].items() <= table2["graphs"].items()
    assert {model["input"] for model in content["models"].values()} == content["graphs"].keys()
