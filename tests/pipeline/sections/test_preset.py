"""Presets hold what differs, keep what does not, and are refused where they are wrong."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.sections import preset

NAMES = [path.stem for path in sorted(preset.PRESETS.glob("*.yaml"))]
OWN: dict[str, Any] = yaml.safe_load(preset.PARAMS.read_text())


def written(folder: Path, text: str) -> str:
    """Write a user's own preset; return its path, by which it is named."""
    path = folder / "mine.yaml"
    path.write_text(text)
    return str(path)


def leaves(content: dict[str, Any], *above: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in content.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, *above, key)
        else:
            yield (*above, key), value


def at(content: Any, keys: tuple[str, ...]) -> Any:
    for key in keys:
        content = content.get(key) if isinstance(content, dict) else None
    return content


def test_they_are_short() -> None:
    """But for the points of studies, which are a line each."""
    lines = {name: len(preset.find(name).read_text().splitlines()) for name in NAMES}
    assert lines.keys() >= {"kitti", "real", "replay", "studies", "table2"}
    assert max(count for name, count in lines.items() if name != "studies") <= 50


@pytest.mark.parametrize("name", NAMES)
def test_a_preset_holds_what_differs_and_nothing_else(name: str) -> None:
    changes, merged = yaml.safe_load(preset.find(name).read_text()), preset.merged(name)
    for keys, value in leaves(changes):
        assert at(OWN, keys) != value, f"{name}: {'.'.join(keys)} is as in params.yaml"
        assert at(merged, keys) == value
    touched = {keys for keys, _ in leaves(changes)}
    for keys, value in leaves(OWN):
        if not any(keys[: len(changed)] == changed[: len(keys)] for changed in touched):
            assert at(merged, keys) == value


@pytest.mark.parametrize("name", NAMES)
def test_comments_stay_and_the_head_says_where_it_is_from(name: str) -> None:
    head, *rest = preset.text(name).splitlines()
    about = preset.find(name).read_text().splitlines()[0]
    assert about.startswith("# ")
    assert f"presets/{name}.yaml" in head
    assert head.endswith(about.removeprefix("# "))
    own = preset.PARAMS.read_text()
    assert [line for line in rest if line.lstrip().startswith("#")] == re.findall(r"^ *#.*", own, re.MULTILINE)
    for line in own.splitlines():
        knob, _, comment = line.partition(" # ")
        if comment and any(other.startswith(knob.partition(":")[0] + ":") for other in rest):
            assert any(comment in other for other in rest), line


def test_kitti_has_whole_scans_and_the_references_sizes() -> None:
    variants = preset.merged("kitti")["graphs"]
    assert variants["lidar"] == {"source": "clouds/lidar", "points": 43000, "k": 6}
    assert variants["lidar-pointnet2"] == {"source": "clouds/lidar", "points": 45000, "neighbourhood": "pointnet2"}


def test_mappings_are_merged_and_all_else_is_replaced(tmp_path: Path) -> None:
    name = written(
        tmp_path,
        "town: {replay: data/raw, frames: {val: 7}}\n"
        "train: {seeds: [3, 4]}\n"
        "encoder: {weights: {backbone: a.pth}, frozen: true}\n"
        "models:\n"
        "  sa-gnn-ncp: {semantics: null, equivariant: null, wiring: {command: 5}}\n"
        "  new: {input: depth, spatial: gnn, temporal: lstm, window: 4, layers: [8, 8], equivariant: true}\n",
    )
    merged = preset.merged(name)
    assert merged["town"] == OWN["town"] | {"replay": "data/raw", "frames": OWN["town"]["frames"] | {"val": 7}}
    assert merged["train"]["seeds"] == [3, 4]
    assert merged["encoder"]["weights"] == {"backbone": "a.pth"}
    line = OWN["models"]["sa-gnn-ncp"]
    own = {key: value for key, value in line.items() if key not in ("semantics", "equivariant")}
    assert merged["models"]["sa-gnn-ncp"] == {**own, "wiring": {"command": 5}}
    new = {"input": "depth", "spatial": "gnn", "temporal": "lstm", "window": 4, "layers": [8, 8], "equivariant": True}
    assert merged["models"]["new"] == new


def test_null_is_the_value_of_a_knob_that_has_no_default(tmp_path: Path) -> None:
    replaying = tmp_path / "params.yaml"
    replaying.write_text(preset.text("replay"))
    assert preset.merged(written(tmp_path, "town: {replay: null}"), replaying)["town"]["replay"] is None


def test_a_model_goes_by_null_and_another_comes(tmp_path: Path) -> None:
    line = "{input: image, spatial: cnn, temporal: ncp, window: 4}"
    merged = preset.merged(written(tmp_path, f"models: {{sa-gnn-ncp: null, cnn: {line}}}"))
    assert merged["models"] == {"cnn": yaml.safe_load(line)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# Head.\ntrain:\n  epoch: 3\n", r":3: unknown key train\.epoch: did you mean epochs"),
        ("train:\n  epochs: 3\n  epoch: null\n", r":3: unknown key train\.epoch"),
        ("\ntrian: {epochs: null}\n", r":2: unknown key trian: did you mean train"),
        ("graphs:\n  lidar: {pionts: 5}\n", r":2: unknown key graphs\.lidar\.pionts: did you mean points"),
        (
            "encoder:\n  teacher:\n    backbone: small\n    weigths: a.pt\n",
            r":4: unknown key encoder\.teacher\.weigths",
        ),
        ("town:\n  frames:\n    tests: 3\n", r":3: unknown key town\.frames\.tests"),
        ("models:\n  sa-gnn-ncp:\n    window: 0\n", r":3: models\.sa-gnn-ncp\.window = 0"),
        ("models:\n  sa-gnn-ncp:\n    semantcs: 1.0\n", r":3: models\.sa-gnn-ncp\.semantcs.*did you mean semantics"),
        ("models:\n  sa-gnn-ncp:\n    wiring: {comand: 3}\n", r":3: models\.sa-gnn-ncp\.wiring\.comand"),
        ("models:\n\n  new: {spatial: gnn, temporal: ncp, window: 8}\n", r":3: models\.new\.input is missing"),
        ("models:\n  a;b: {input: depth, spatial: gnn, temporal: ncp, window: 8}\n", r":2: models\.a;b"),
        ("models:\n  sa-gnn-ncp: null\n", r":1: models: .*at least 1"),
        ("models:\n  other: null\n", r":2: models\.other = None"),
        ("graphs: 5\n", r":1: graphs = 5"),
        ("graphs:\n  depth:\n    k: null\n", r":2: graphs\.depth: .*needs k"),
        ("ingest:\n  image_size:\n  - 96\n  - 8\n", r":4: ingest\.image_size\.1 = 8"),
        ("train:\n  seeds: [1, 1]\n", r":2: train\.seeds = \[1, 1\]"),
        ("train:\n  epochs: null\n", r":2: train\.epochs = None"),
        ("encoder:\n  weights: {dept_head: a.pth}\n", r":2: encoder\.weights: .*depth_head"),
        ("train:\n  epochs: 1\n  epochs: 2\n", r":3 is not valid YAML: .*duplicate"),
        ("train: [1\nx\n", r":3 is not valid YAML"),
        ("a: \x07\n", r" is not valid YAML"),
        ("- 1\n", r" holds no sections"),
        ("# nothing\n", r" holds no sections"),
    ],
)
def test_a_fault_is_named_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    name = written(tmp_path, text)
    with pytest.raises(InputError, match=f"^{re.escape(name)}{message}"):
        preset.text(name)


def test_a_fault_of_params_yaml_is_not_the_presets(tmp_path: Path) -> None:
    params = tmp_path / "params.yaml"
    params.write_text(preset.PARAMS.read_text().replace("  patience:", "  patients:"))
    line = (
        params.read_text().splitlines().index(next(row for row in params.read_text().splitlines() if "patients" in row))
    )
    with pytest.raises(InputError, match=rf"^{re.escape(str(params))}:{line + 1}: unknown key train\.patients"):
        preset.text("kitti", params)
    with pytest.raises(InputError, match=r"nowhere\.yaml is missing"):
        preset.text("kitti", tmp_path / "nowhere.yaml")


@pytest.mark.parametrize("name", ["kiti", "nowhere/kitti.yaml", "kitti.yaml"])
def test_an_unknown_preset_is_told_which_there_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=rf"'{name}'.*presets.*{', '.join(NAMES)}"):
        preset.text(name)


def test_lines_that_no_longer_fit_are_broken_at_every_key(tmp_path: Path) -> None:
    text = preset.text(written(tmp_path, "graphs: {lidar: {points: 430000, seed: 12}}"))
    assert "  lidar:\n    source: clouds/lidar\n    points: 430000\n    k: 6\n    crop_m:\n    - -15\n" in text


def test_written_over_params_yaml_it_says_so_and_tells_all_that_lie_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / "params.yaml"
    params.write_text(preset.PARAMS.read_text())
    assert preset.main("real", params, params) == params
    assert yaml.safe_load(params.read_text()) == preset.merged("real")
    assert "real.yaml" in capsys.readouterr().out
    once = params.read_text()
    preset.main("real", params, params)
    assert params.read_text() == once
    capsys.readouterr()
    preset.main("table2", params, params)
    printed = capsys.readouterr().out
    assert str(params) in printed
    assert printed.index("table2.yaml") < printed.index("real.yaml")
    content = yaml.safe_load(params.read_text())
    assert content["models"] == preset.merged("real")["models"] | preset.merged("table2")["models"]
    assert content["ingest"] == preset.merged("real")["ingest"]


def test_without_a_file_to_write_it_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert preset.main("kitti", params=preset.PARAMS) is None
    assert capsys.readouterr().out == preset.text("kitti")
