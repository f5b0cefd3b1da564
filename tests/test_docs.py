"""Test the Markdown pages: their number, size and width, and that links and names lead to something
that exists.
"""

import json
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import typer
import yaml

from docs import make_results
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.keys import ROOT
from pipeline.base.store import DriveReader
from pipeline.evaluate.own_metrics import METRICS
from pipeline.graphs.settings import Variant
from pipeline.train import quantity
from stages import preset, report
from steer.app import app
from tests import artefacts, small_model
from tests.pipeline.report import examples

PAGES = [ROOT / "README.md", ROOT / "data/README.md"] + [
    ROOT / f"docs/{name}.md"
    for name in ("measure", "models", "paper", "real", "results", "running")
]
TEXTS = [
    *PAGES,
    *(ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "docs/history.md")),
]
LINK = re.compile(r"\[[^\]]*\]\(([^)]+)\)")
CODE = re.compile(r"```(?:\w*\n)?(.*?)```|`([^`]+)`", re.DOTALL)
SECTIONS = {
    key: getattr(section.annotation, "model_fields", {})
    for key, section in preset.Params.model_fields.items()
}
PLACEHOLDERS = {
    "models/steering/spatial/height.py",
    "models/steering/spatial/NAME.py",
    "pipeline/train/quantities/curvature.py",
    "presets/NAME.yaml",
}
PLACEHOLDERS |= {f"presets/{name}.yaml" for name in ("monday", "more", "NAME")}
# of DVC and git
OTHERS = {
    "--ours",
    "--theirs",
    "--force",
    "--single-item",
    "--wait-for-lock",
    "--pull",
    "--downstream",
    "--allow-missing",
    "--nthreads",
    "--nworkers",
}


def code_block(part: str) -> str:
    """Return the first code block of the pages that contains a text, without its fences."""
    blocks = (block for page in PAGES for block in page.read_text().split("```")[1::2])
    return next(block for block in blocks if part in block)


def headings(page: Path) -> set[str]:
    """Return the anchors of a page as GitHub names them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings_and_prose_has_110_columns(page):
    for link in LINK.findall(page.read_text()):
        name, _, anchor = link.partition("#")
        # README's badge leads to GitHub's pages of this repository.
        if not name.startswith(("http://", "https://", "../../actions/")):
            target = (page.parent / name).resolve() if name else page
            assert target.exists(), link
            assert not anchor or anchor in headings(target), link
    prose = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    wide = [
        line
        for line in prose.splitlines()
        if len(line) > 110 and not line.startswith(("|", "!", "<!--"))
    ]
    assert wide == []


def test_version_and_date_of_the_release_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    newest = re.search(r"^## (\S+) - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest.groups() == (project["version"], str(citation["date-released"]))
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]


def test_figures_and_tables_are_those_of_the_runs():
    pages = make_results.pages(make_results.read_results())
    assert [page.name for page, text in pages.items() if text != page.read_text()] == []


def test_a_run_of_committed_code_is_collected(tmp_path, monkeypatch):
    monkeypatch.setattr(make_results, "RUNS", tmp_path)
    monkeypatch.setattr(make_results, "render", lambda: None)
    values = {"a/b": {"nmse": 0.5}}
    run = {"preset": "mine", "date": "2026-01-01", "machine": "2 CPU cores", "results": values}
    (tmp_path / "new").write_text(json.dumps(run | {"revision": "abc1234"}))
    make_results.collect(tmp_path / "new")
    for revision in ("abc1234-dirty", "unknown"):
        (tmp_path / "new").write_text(json.dumps(run | {"revision": revision}))
        with pytest.raises(InputError, match=revision):
            make_results.collect(tmp_path / "new")
    assert make_results.read_results()["mine"] == values


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_figures_without_a_key_name_their_revision(page):
    text = make_results.VALUE.sub("", make_results.TABLE.sub("", page.read_text()))
    prose = CODE.sub("", text)
    figures = [
        part
        for part in re.split("^#", prose, flags=re.MULTILINE)
        if re.search(r"(?<![\d.])\d?\.\d{3}\b", part)
    ]
    assert [part for part in figures if not re.search(r"\b[0-9a-f]{7,8}\b", part)] == []


def test_the_pages_and_the_method_of_the_readme():
    assert {*(ROOT / "docs").glob("*.md")} == {*PAGES[2:], ROOT / "docs/history.md"}
    readme = PAGES[0].read_text()
    example = (ROOT / "examples/one_image.py").read_text()
    assert [line for line in code_block("gcn.layers").splitlines()[1:] if line not in example] == []
    assert [
        path.name for path in (ROOT / "pipeline").glob("[!_]*/") if f"{path.name}/" not in readme
    ] == []


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: str(page.relative_to(ROOT))
)
def test_names_exist(page):
    """Paths of the repository, settings, targets of make, and the commands and options of steer."""
    code = "\n".join(block or span for block, span in CODE.findall(page.read_text()))
    paths = re.findall(r"\b(?:pipeline|models|stages|tests|steer|presets|docs)/[\w/]+\.\w+", code)
    assert [path for path in paths if not (ROOT / path).exists() and path not in PLACEHOLDERS] == []

    spans = " ".join(span for _, span in CODE.findall(page.read_text()))
    settings = [
        (section, key)
        for section, key in re.findall(r"\b([a-z]+)\.([a-z_]+)\b", spans)
        if section in SECTIONS
    ]
    assert [
        f"{section}.{key}"
        for section, key in settings
        if key not in SECTIONS[section] and key != "pt"
    ] == []

    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    targets += [Path(path).stem for path in (*(ROOT / "presets").glob("*.yaml"), *PLACEHOLDERS)]
    assert {*re.findall(r"(?:^|&& )make ([a-z]\w*)", code, re.MULTILINE)} <= {*targets}

    steer = typer.main.get_command(app)
    commands = steer.commands  # type: ignore[attr-defined]
    assert {*re.findall(r"\bsteer ([a-z]+)", code)} <= {*commands}
    options = {
        name
        for command in (steer, *commands.values())
        for option in command.params
        for name in option.opts
    }
    options |= {
        name
        for command in commands.values()
        for option in command.params
        for name in option.secondary_opts
    }
    assert {*re.findall(r"(?<!\S)--[a-zA-Z][\w-]*", code)} <= options | OTHERS


def test_the_keys_of_graphs_have_the_defaults_of_the_settings():
    _, _, text = (ROOT / "docs/models.md").read_text().partition("\n## Graphs\n")
    section, _, _ = text.partition("\n## ")
    rows = [line.split(" | ") for line in section.splitlines() if line.startswith("| `")]
    documented = {key.strip("| `"): default for key, default, _ in rows}

    expected = {}
    for name, field in Variant.model_fields.items():
        expected[name] = "required"
        if not field.is_required() and name != "points":  # images have no points
            expected[name] = f"`{json.dumps(field.default)}`".replace('"', "")
    assert documented == expected


def test_the_quantity_of_the_documentation_is_trained_evaluated_and_shown(tmp_path, monkeypatch):
    """Tables, metrics and page show it in its own unit, beside its baselines."""
    module = ModuleType("pipeline.train.quantities.curvature")
    exec(code_block('title = "curvature"').removeprefix("python\n"), vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(quantity, "NAMES", ["angle", "curvature"])
    artefacts.write_dataset(tmp_path, small_model.SPLITS, frames=60, points=20, motion=True)
    model = {"predict": "curvature", "temporal": "lstm", "motion": "visual"}
    small_model.write_params(tmp_path, model, epochs=1)
    small_model.run_train(tmp_path)
    path = small_model.run_evaluate(tmp_path) / "metrics.json"
    metrics = store.read_json(path, stage="evaluate")
    assert [*metrics["test"]] == ["net"]
    metrics["variant"]["source"] = "clouds/pseudo"  # the graphs of tests do not name it
    store.write_json(path, metrics)
    table = pd.read_csv(tmp_path / "evaluate/net/predictions.csv")
    of_seed = table[table["seed"] == 0]
    angle_rad = np.arctan(of_seed["true_curvature_1pm"] * artefacts.WHEELBASE_M)
    with DriveReader(tmp_path / f"labels/{small_model.TEST}.h5", stage="labels") as labels:
        np.testing.assert_allclose(angle_rad, labels["steering_rad"], atol=1e-6)

    report.main(tmp_path, tmp_path / "report", tmp_path / "params.yaml")
    text = (tmp_path / "report/table.md").read_text()
    assert "## Results: curvature" in text
    assert re.search(r"\| +MAE 1/m \|", text)
    sentence = r"Its mean absolute error of the curvature is [\d.e-]+ 1/m"
    assert re.search(sentence, " ".join(text.split()))
    rows = json.loads((tmp_path / "report/metrics.json").read_text())
    assert {"curvature-0/net", "curvature-0/odometry", "curvature-0/persistence"} <= {*rows}
    error_1pm = (table["predicted_curvature_1pm"] - table["true_curvature_1pm"]).abs().mean()
    assert rows["curvature-0/net"]["mae"] == pytest.approx(error_1pm, rel=1e-4)
    page = (tmp_path / "report/index.html").read_text()
    assert "The curvature over time, in the drives of " in page


@pytest.mark.parametrize("predict", ["angle", "path"])
def test_a_metric_of_the_documentation_is_right_in_both_units(tmp_path, monkeypatch, predict):
    """It stands in tables, page and `dvc metrics`, for the network as for the baselines.

    The error is a share of the truth, which is 0.01 times the frame's number.
    """
    names = {"METRICS": METRICS, "np": np}
    monkeypatch.setitem(METRICS, "within_2_deg", None)  # so that it is removed afterwards
    exec(code_block("def within_2_deg").removeprefix("python\n"), names)
    error, factor = {"angle": (0.2, 1), "path": (0.04, 5)}[predict]
    content = examples.metrics("net", error**2, {"odometry": error**2}, predict=predict)
    examples.write_model(tmp_path, content)
    (tmp_path / "params.yaml").write_text(
        "models: {net: {}}\nevaluate: {bootstrap_samples: 9, bootstrap_block_frames: 5, seed: 0}\n"
    )
    report.main(tmp_path, params=tmp_path / "params.yaml")

    # The turn in a range of 5 m is five times its curvature.
    frame = np.delete(np.arange(7, 30), 13)
    share = (error * 0.01 * factor * frame < np.radians(2)).mean()
    assert 0 < share < 1
    key = {"angle": "angle-0", "path": "path-0/5-10 m"}[predict]
    metrics = json.loads((tmp_path / "report/metrics.json").read_text())
    for name in ("net", "odometry"):
        assert metrics[f"{key}/{name}"]["within_2_deg"] == pytest.approx(share)
    assert "within_2_deg" in metrics[f"{key}/zero"]
    head = {"angle": "within_2_deg", "path": "within_2_deg 5-10 m"}[predict]
    table = (tmp_path / "report/table.md").read_text()
    assert head in table
    assert f"{share:.3f}" in table
    page = (tmp_path / "report/index.html").read_text()
    assert f'<th scope="col">{head}</th>' in page
    assert f"<td>{share:.3f}</td>" in page
