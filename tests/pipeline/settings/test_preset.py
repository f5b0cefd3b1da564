"""Presets are merged into params.yaml and keep its comments."""

import re
from pathlib import Path

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.settings import preset
from tests.kitti_drive import contents

NAMES = [path.stem for path in sorted(preset.PRESETS.glob("[a-z]*.yaml"))]


def written(folder: Path, text: str) -> str:
    """Write a user's preset; return its path."""
    path = folder / "mine.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", NAMES)
def test_the_text_is_the_merged_content_with_all_comments(name: str) -> None:
    text = preset.text(name)
    assert yaml.safe_load(text) == preset.merged(name)
    head, *rest = text.splitlines()
    assert f"presets/{name}.yaml" in head
    original = preset.PARAMS.read_text()
    assert [line for line in rest if line.lstrip().startswith("#")] == re.findall(r"^ *#.*", original, re.MULTILINE)
    for line in original.splitlines():
        key, _, comment = line.partition(" # ")
        if comment and any(other.startswith(key.partition(":")[0] + ":") for other in rest):
            assert any(comment in other for other in rest), line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train:\n  epoch: 3\n", r"train\.epoch.*did you mean epochs"),
        ("models:\n  a;b: {input: semantic, spatial: gnn, temporal: ncp, window: 8}\n", "letters"),
        ("models:\n  sa-gnn-ncp: null\n", "models.*at least 1"),
        ("train:\n  epochs: null\n", r"train\.epochs.*missing"),
        ("train:\n  epochs: 1\n  epochs: 2\n", "duplicate"),
        ("train:\n  epochs: '5'\n", r"train\.epochs: .*valid integer.*got '5'"),
        ("# nothing\n", "expected sections"),
    ],
)
def test_a_fault_is_named_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    name = written(tmp_path, text)
    with pytest.raises(InputError, match=message) as raised:
        preset.text(name)
    assert name in str(raised.value)


@pytest.mark.parametrize("name", ["kiti", "nowhere/kitti.yaml", "kitti.yaml"])
def test_an_unknown_preset_is_refused_with_those_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as raised:
        preset.text(name)
    assert raised.value.where == name
    assert ", ".join(NAMES) in raised.value.fix


def test_presets_can_be_written_over_params_yaml_one_after_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / "params.yaml"
    params.write_text(preset.PARAMS.read_text())
    assert preset.main("real", params, params) == params
    assert "real.yaml" in capsys.readouterr().out
    once = params.read_text()
    preset.main("real", params, params)
    assert params.read_text() == once
    preset.main("table2", params, params)
    content = yaml.safe_load(params.read_text())
    assert content["models"] == preset.merged("real")["models"] | preset.merged("table2")["models"]
    assert content["ingest"] == preset.merged("real")["ingest"]


def test_a_star_removes_all_earlier_entries(tmp_path: Path) -> None:
    """An entry of the same name does not inherit their settings."""
    model = "{input: semantic, spatial: gnn, temporal: lstm, window: 4}"
    first = written(tmp_path, f"models:\n  sa-gnn-ncp: {model}\n  '*': null\n")
    assert preset.merged(first)["models"] == {"sa-gnn-ncp": yaml.safe_load(model)}
    assert yaml.safe_load(preset.text(first)) == preset.merged(first)
    nothing = written(tmp_path, "models:\n  '*': null\n")
    with pytest.raises(InputError, match=r"models.*at least 1"):
        preset.merged(nothing)


def test_only_a_params_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/file").write_text("content")
    (tmp_path / "other.yaml").write_text("content: 1\n")
    (tmp_path / "notes.yaml").write_text("train: half past five\n")
    (tmp_path / "comments.yaml").write_text("# only notes\n")
    before = contents(tmp_path)
    for name in ("folder", "other.yaml", "notes.yaml", "comments.yaml"):
        with pytest.raises(InputError) as raised:
            preset.main("table2", tmp_path / name)
        assert raised.value.where == str(tmp_path / name)
    assert contents(tmp_path) == before


def test_commented_variants_and_models_are_those_of_table2() -> None:
    text = re.sub(r"^# (?=[\w-]+: \{)", "  ", preset.PARAMS.read_text(), flags=re.MULTILINE)
    content, table2 = yaml.safe_load(text), preset.merged("table2")
    models = {name: model for name, model in content["models"].items() if model.get("predict") != "path"}
    graphs = {model["input"]: content["graphs"][model["input"]] for model in models.values()}
    assert (len(models), len(graphs)) == (9, 6)
    assert models.items() <= table2["models"].items()
    assert graphs.items() <= table2["graphs"].items()
