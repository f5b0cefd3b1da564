"""Test the Markdown pages: their number, size and width, and that links and names lead to something
that exists.
"""

import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal

import h5py
import numpy as np
import pandas as pd
import pytest
import typer
import yaml
from pydantic import Field

from docs import make_results, make_settings
from models.steering.core.batch import GraphBatch, from_arrays
from models.steering.core.options import NetworkOptions
from pipeline.base import store
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.base.params import parse, read_yaml
from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.check.settings import Params
from pipeline.clouds import columns
from pipeline.clouds.cloud import Cloud
from pipeline.evaluate.own_metrics import METRICS, Metric
from pipeline.graphs.graph_file import open_graphs
from pipeline.labels.label_file import open_labels
from pipeline.report import tables
from pipeline.train import quantity, trained
from pipeline.train.entry import Entry
from stages import check, clouds, graphs, preset, report
from steer.app import app
from steer.export import export_points
from tests import artefacts, small_model, street
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
    "models/steering/spatial/surface.py",
    "models/steering/temporal/gru.py",
    "pipeline/train/quantities/curvature.py",
    "presets/NAME.yaml",
    "presets/monday.yaml",
}
# Options of DVC, git, and of all stages.
OTHERS = {
    "--data",
    "--ours",
    "--theirs",
    "--force",
    "--single-item",
    "--wait-for-lock",
    "--pull",
    "--downstream",
    "--allow-missing",
    "--drop",
    "--only-changed",
    "--open",
    "--nthreads",
    "--nworkers",
    "--bind",
    "--local",
    "--relink",
}


def code_block(part: str) -> str:
    """Return the first code block of the pages that contains a text, without its fences."""
    blocks = (block for page in PAGES for block in page.read_text().split("```")[1::2])
    return next(block for block in blocks if part in block)


def test_every_python_block_is_run():
    """A test names it by code_block, and runs it; of README, the example has its lines."""
    tests = [path.read_text() for path in (ROOT / "tests").glob("test_*.py")]
    parts = re.findall(r"""code_block\((["'])(.+?)\1\)""", "".join(tests))
    blocks = (block for page in PAGES for block in page.read_text().split("```")[1::2])
    for block in blocks:
        if block.startswith("python\n"):
            assert [part for _, part in parts if code_block(part) == block], block


def test_drives_of_examples_are_those_of_the_demo():
    """In code blocks of pages, and in the help of steer."""
    drives = parse(Params, read_yaml(ROOT / "params.yaml")).ingest.drives.splits()
    texts = [path.read_text() for path in (ROOT / "steer").rglob("*.py")]
    for page in (ROOT / "data/README.md", ROOT / "docs/models.md"):
        texts += page.read_text().split("```")[1::2]
    named = {*re.findall(r"2026_\d\d_\d\d_drive_\d{4}", "\n".join(texts))}
    assert named
    assert named <= {*drives}


def test_the_models_of_the_documentation_for_a_recording_are_valid():
    models = yaml.safe_load(code_block("path-blind: {input: depth").removeprefix("yaml\n"))
    for name, model in models.items():
        entry = Entry.model_validate(model)
        assert entry.predicts_ahead
        assert entry.network.sees_frames == (name == "path")


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
    pages = make_results.pages(make_results.read_runs())
    assert [page.name for page, text in pages.items() if text != page.read_text()] == []


def test_the_demo_was_run_with_the_present_settings():
    """After a change of params.yaml: run the demo again, and collect its results."""
    demo = [run for run in make_results.read_runs() if run["preset"] == "demo"]
    present = parse(Params, read_yaml(ROOT / "params.yaml"))
    assert [parse(Params, run["settings"]) for run in demo] == [present]


def test_a_run_is_collected_if_its_code_was_committed(tmp_path, monkeypatch):
    monkeypatch.setattr(make_results, "RUNS", tmp_path)
    monkeypatch.setattr(make_results, "render", lambda: None)
    run = {"preset": "mine", "date": "2026-01-01", "machine": "2 CPU cores", "results": {"a": {}}}
    new = tmp_path / "new"
    store.write_json(new, run | {"revision": "abc1234"})
    make_results.collect(new)
    assert make_results.read_runs() == [run | {"revision": "abc1234"}]
    store.write_json(new, run | {"revision": "abc1234-dirty"})
    with pytest.raises(InputError, match="abc1234-dirty"):
        make_results.collect(new)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_figures_without_a_key_name_their_revision(page):
    text = make_results.VALUE.sub("", make_results.TABLE.sub("", page.read_text()))
    for part in re.split("^#", CODE.sub("", text), flags=re.MULTILINE):
        has_figure = re.search(r"(?<![\d.])\d?\.\d{3}\b", part)
        assert not has_figure or re.search(r"\b[0-9a-f]{7,8}\b", part), part


def test_the_pages_and_the_method_of_the_readme():
    assert {*(ROOT / "docs").glob("*.md")} == {*PAGES[2:], ROOT / "docs/history.md"}
    readme = PAGES[0].read_text()
    example = (ROOT / "examples/one_image.py").read_text()
    assert [line for line in code_block("gcn.layers").splitlines()[1:] if line not in example] == []
    for path in (ROOT / "pipeline").glob("[!_]*/"):
        assert f"{path.name}/" in readme


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: str(page.relative_to(ROOT))
)
def test_names_exist(page):
    """Paths of the repository, settings, targets of make, and the commands and options of steer."""
    code = "\n".join(block or span for block, span in CODE.findall(page.read_text()))
    paths = re.findall(r"\b(?:pipeline|models|stages|tests|steer|presets|docs)/[\w/]+\.\w+", code)
    assert [path for path in paths if not (ROOT / path).exists() and path not in PLACEHOLDERS] == []

    spans = " ".join(span for _, span in CODE.findall(page.read_text()))
    for section, key in re.findall(r"\b([a-z]+)\.([a-z_]+)\b", spans):
        if section in SECTIONS and key not in ("pt", "png"):
            assert key in SECTIONS[section], f"{section}.{key}"

    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    targets += [Path(path).stem for path in (*(ROOT / "presets").glob("*.yaml"), *PLACEHOLDERS)]
    assert {*re.findall(r"(?:^|&& )make ([a-z]\w*)", code, re.MULTILINE)} <= {*targets}

    steer = typer.main.get_command(app)
    commands = steer.commands  # type: ignore[attr-defined]
    assert {*re.findall(r"\bsteer ([a-z]+)", code)} <= {*commands}
    options = {*OTHERS}
    for command in (steer, *commands.values()):
        for option in command.params:
            options |= {*option.opts, *option.secondary_opts}
    assert {*re.findall(r"(?<!\S)--[a-zA-Z][\w-]*", code)} <= options


def test_tables_of_settings_are_those_of_the_code():
    """After a change of a key, a default, a network or a quantity: python -m docs.make_settings."""
    pages = make_settings.pages()
    assert [page.name for page, text in pages.items() if text != page.read_text()] == []
    names = [name for text in pages.values() for _, name, _ in make_settings.TABLE.findall(text)]
    assert sorted(names) == sorted([*Params.model_fields, "networks"])


def test_a_row_has_the_limits_of_its_field_and_needs_a_description():
    class Group(NetworkOptions):
        share: Annotated[float, Field(gt=0, le=1)] = Field(description="a share")

    class Options(NetworkOptions):
        layers: tuple[Literal[3, 5], ...] = Field(default=(3,), max_length=4, description="a | b")
        group: Group = Group(share=0.5)
        seed: Annotated[int, Field(ge=0)] | None = Field(default=None, description="a seed")
        width: int = 64

    schema = Options.model_json_schema()
    keys = make_settings.describe_keys(schema, schema, {"group": {"share": 1.0}})
    rows = [next(keys) for _ in range(3)]
    assert make_settings.to_markdown(("key",), rows).splitlines()[2:] == [
        r"| `layers` | `[3]` | list of 0 to 4: `3`, `5` | a \| b |",
        "| `group.share` | `1.0` | number > 0 and ≤ 1 | a share |",
        "| `seed` | `null` | integer ≥ 0, `null` | a seed |",
    ]
    with pytest.raises(InputError, match="width has no description"):
        next(keys)


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
    metrics["variant"]["source"] = "clouds/pseudo"  # the graphs of tests do not name it
    store.write_json(path, metrics)
    table = pd.read_csv(tmp_path / "evaluate/net/predictions.csv")
    of_seed = table[table["seed"] == 0]
    angle_rad = np.arctan(of_seed["true_curvature_1pm"] * artefacts.WHEELBASE_M)
    with open_labels(tmp_path / f"labels/{small_model.TEST}.h5") as labels:
        np.testing.assert_allclose(angle_rad, labels["steering_rad"], atol=1e-6)

    report.main(tmp_path, params=tmp_path / "params.yaml")
    assert re.search(r"\| +MAE 1/m \|", (tmp_path / "report/table.md").read_text())
    rows = store.read_json(tmp_path / "report/results.json", stage="report")
    assert {"curvature-0/net", "curvature-0/odometry", "curvature-0/persistence"} <= {*rows}
    error_1pm = (table["predicted_curvature_1pm"] - table["true_curvature_1pm"]).abs().mean()
    assert rows["curvature-0/net"]["mae"] == pytest.approx(error_1pm, rel=1e-4)
    shown = store.read_json(tmp_path / "report/metrics/error.json", stage="report")
    assert shown == {"net": rows["curvature-0/net"]["nmse"]}


def test_the_edges_of_the_data_card_are_those_of_a_batch(tmp_path, monkeypatch):
    drive = "2026_06_01_drive_0004"
    frame = np.arange(8)
    path = tmp_path / f"data/graphs/semantic/{drive}.h5"
    artefacts.write_graphs(path, np.full(8, 0.1), frame, points=20)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"h5py": h5py, "np": np, "drive": drive}
    exec(code_block('["indices_ptr"]').removeprefix("python\n"), names)
    with open_graphs(path) as graphs:
        batch = from_arrays(artefacts.collate((graphs, 7, 8)))
    assert isinstance(batch, GraphBatch)
    np.testing.assert_array_equal(names["edge_index"], batch.edge_index)
    assert (*names["class_names"],) == classes.NAMES


def test_the_column_of_the_documentation_goes_from_the_points_into_a_network(tmp_path, monkeypatch):
    """Normals of a street of planes; stage check, clouds, graphs, training and export have them."""
    for source in columns.SOURCES.values():
        monkeypatch.setitem(source, "normals", None)  # so that it is removed afterwards
    exec(code_block("def normals").removeprefix("python\n"), {**vars(columns)})
    network: dict[str, Any] = {}
    exec(code_block("class Surface").removeprefix("python\n"), network)
    small_model.add_network(monkeypatch, "surface", network["Options"])

    # The settings of the page, with small sizes.
    chosen = yaml.safe_load(code_block("columns: [normals] ").removeprefix("yaml\n"))
    model = chosen["models"]["surface"]
    small_model.write_params(tmp_path, model, epochs=1, seeds=[0])
    path = tmp_path / "params.yaml"
    params = yaml.safe_load(path.read_text())
    params["clouds"] |= chosen["clouds"] | {"max_points": 700}
    params["graphs"] |= chosen["graphs"]
    params["graphs"]["surfaces"]["points"] = 200
    path.write_text(yaml.safe_dump(params))
    check.main(path)

    # Drives of a road between two walls, whose true depth is known.
    drives = tmp_path / "ingest"
    for drive in small_model.SPLITS:
        street.write_drive(drives, drive, 6)
        street.write_perception(tmp_path / "perception", drives, drive)
        artefacts.write_motion(tmp_path / "motion", drive, dict.fromkeys(range(6), (8.0, 0.1)))
        artefacts.write_labels(tmp_path / f"labels/{drive}.h5", np.full(6, 0.1), np.arange(6))
    artefacts.write_index(drives, small_model.SPLITS)
    artefacts.write_index(tmp_path / "labels", small_model.SPLITS)
    clouds.main(tmp_path, path)
    graphs.main("surfaces", tmp_path, path)

    # The road looks up, and the walls look to each other.
    graph = tmp_path / f"graphs/surfaces/{small_model.TEST}.h5"
    with open_graphs(graph) as file:
        assert file.signs == {"normals": (-1, 1, 1)}
        assert file.units["normals"] == "unit vector"
        assert file.meanings["normals"] == "normal of the surface, towards the camera"
        cloud = Cloud.read(file, ["normals"], slice(None))
        batch = from_arrays(artefacts.collate((file, 0, 6)))
    x, y, z = cloud.xyz.T
    near = z < 20
    surfaces = {
        (0, -1, 0): near & (np.abs(y - CAMERA_HEIGHT_M) < 0.01),
        (1, 0, 0): near & (np.abs(x + street.HALF_WIDTH_M) < 0.01),
        (-1, 0, 0): near & (np.abs(x - street.HALF_WIDTH_M) < 0.01),
    }
    for normal, points in surfaces.items():
        assert points.sum() > 20
        found = np.median(cloud.columns["normals"].rows[points], axis=0)
        assert found == pytest.approx(normal, abs=0.1)

    # The mirror image of the points has the mirrored normals.
    mirror = np.array([-1, 1, 1])
    camera = Camera(street.K, street.SIZE)
    points = columns.Points(cloud.xyz * mirror, cloud.cls, Frame(0, 0.0), camera, None)
    again = columns.compute_columns("pseudo", ["normals"], points)["normals"].rows * mirror
    points = points._replace(xyz=cloud.xyz)
    expected = columns.compute_columns("pseudo", ["normals"], points)["normals"].rows
    assert (np.abs(again - expected).max(axis=1) < 1e-3).mean() > 0.99
    assert isinstance(batch, GraphBatch)
    for name in ("xyz", "normals"):
        mirrored = batch.mirrored().columns[name].numpy()
        np.testing.assert_array_equal(mirrored, batch.columns[name].numpy() * mirror)

    small_model.run_train(tmp_path)
    trained_model = trained.load_model(tmp_path / "train/net", "cpu")
    with open_graphs(graph) as file:
        assert np.isfinite(trained_model.predict(file)[4:]).all()
    export_points(graph, 2, tmp_path / "cloud.ply")
    assert b"property float nx" in (tmp_path / "cloud.ply").read_bytes()

    # A variant without normals is refused by check and by the network.
    params["models"]["net"]["input"] = "semantic"
    path.write_text(yaml.safe_dump(params))
    with pytest.raises(InputError, match=r"models.net: spatial = 'surface' reads column 'normals'"):
        check.main(path)
    artefacts.write_graphs(tmp_path / "without.h5", np.full(6, 0.1), np.arange(6), 20)
    with (
        open_graphs(tmp_path / "without.h5") as file,
        pytest.raises(InputError, match="has no column 'normals', which spatial: surface reads"),
    ):
        trained_model.predict(file)


@pytest.mark.parametrize(
    ("predict", "label", "error", "factor"),
    [("angle", "", 0.2, 1), ("path", "5-10 m", 0.04, 5)],  # a turn is 5 m times the curvature
)
def test_a_metric_of_the_documentation_is_right_in_both_units(
    tmp_path, monkeypatch, predict, label, error, factor
):
    """The error is a share of the truth, which is 0.01 times the frame's number."""
    names = {"METRICS": METRICS, "Metric": Metric, "np": np}
    monkeypatch.setitem(METRICS, "within_2_deg", None)  # so that it is removed afterwards
    monkeypatch.setitem(METRICS, "of_speed", Metric(lambda *_: 0.0, units=("m/s",)))
    exec(code_block("def within_2_deg").removeprefix("python\n"), names)
    content = examples.metrics("net", error**2, {"odometry": error**2}, predict=predict)
    values = examples.compare(tmp_path, content)
    frame = np.delete(np.arange(7, 30), 13)
    share = (error * 0.01 * factor * frame < np.radians(2)).mean()
    assert 0 < share < 1
    for name in ("net", "odometry"):
        row = values.loc[(f"{predict}-0", label, name)]
        assert row["within_2_deg"] == pytest.approx(share)
    sections = [tables.results_table(values, f"{predict}-0")]
    sections += tables.nmse_tables(values, f"{predict}-0")
    shown = [section.table.get(f"within_2_deg {label}".strip(), []) for section in sections]
    assert f"{share:.3f}" in [cell for cells in shown for cell in cells]
    titles = [title for section in sections for title in section.table]
    assert [title for title in titles if "of_speed" in title] == []
