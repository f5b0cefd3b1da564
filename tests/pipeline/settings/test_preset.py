"""Presets are merged into params.yaml and keep its comments."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.settings import preset

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
    assert head.startswith("# Written by make params")
    original = preset.PARAMS.read_text()
    assert [line for line in rest if line.lstrip().startswith("#")] == re.findall(r"^ *#.*", original, re.MULTILINE)
    for line in original.splitlines():
        key, _, comment = line.partition(" # ")
        if comment and any(other.startswith(key.partition(":")[0] + ":") for other in rest):
            assert any(comment in other for other in rest), line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train:\n  epoch: 3\n", "train: unknown key 'epoch': did you mean epochs"),
        ("models:\n  sa-gnn-ncp: null\n", "models.*at least 1"),
        ("train:\n  epochs: null\n", r"train\.epochs: Field required"),
        ("train:\n  epochs: '5'\n", r"train\.epochs: .*valid integer.*got '5'"),
    ],
)
def test_a_fault_is_named_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    name = written(tmp_path, text)
    with pytest.raises(InputError, match=message) as raised:
        preset.text(name)
    assert name in str(raised.value)


def test_a_star_removes_all_earlier_entries(tmp_path: Path) -> None:
    """An entry of the same name does not inherit their settings."""
    model = "{input: semantic, spatial: gnn, temporal: lstm, semantics: 0.5}"
    first = written(tmp_path, f"models:\n  sa-gnn-ncp: {model}\n  '*': null\n")
    assert preset.merged(first)["models"] == {"sa-gnn-ncp": yaml.safe_load(model)}


def test_params_are_replaced_unless_they_have_edits_that_git_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*words: str) -> None:
        who = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
        subprocess.run(["git", *who, *words], check=True)

    monkeypatch.chdir(tmp_path)
    params = Path("params.yaml")
    params.write_text(preset.PARAMS.read_text())
    git("init", "-q")
    git("add", "params.yaml")
    git("commit", "-qm", "params")
    for name in ("real", "real", "table2"):  # one after another; the second time changes nothing
        preset.main(name)
    assert params.read_text().count("# Written by make params") == 1
    content = yaml.safe_load(params.read_text())
    assert content["models"] == preset.merged("real")["models"] | preset.merged("table2")["models"]
    assert content["ingest"] == preset.merged("real")["ingest"]

    edited = params.read_text().replace("bootstrap_samples: 2000", "bootstrap_samples: 100")
    params.write_text(edited)
    with pytest.raises(InputError, match="not committed"):
        preset.main("table2")
    assert params.read_text() == edited
    git("commit", "-qam", "edits")
    preset.main("table2")
    assert yaml.safe_load(params.read_text())["evaluate"]["bootstrap_samples"] == 100
