"""dvc.yaml agrees with the code: a stage depends on each file it imports, and on little else."""

import ast
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from pipeline.jobs import keys

from pipeline.graphs.settings import Variant
from pipeline.labels.settings import Labels

CONFIG: dict[str, Any] = yaml.safe_load((keys.ROOT / "dvc.yaml").read_text())
STAGES: dict[str, Any] = {
    name: {**stage, **stage.get("do", {})} for name, stage in CONFIG["stages"].items()
}
NETWORKS = {
    "${item.spatial}": "models/steering/spatial",
    "${item.temporal}": "models/steering/temporal",
}
# Packages with files that are found by their names.
FOUND = {"pipeline/ingest", "pipeline/train/quantities"}
# Stage → packages that it lists although it does not import every file. Of other packages it lists
# single files.
PACKAGES = {
    "perception": {"pipeline/base", "pipeline/camera", "models/encoder"},
    "clouds": {"pipeline/base", "pipeline/camera"},
    "graphs": {"pipeline/base", "pipeline/camera", "pipeline/clouds", "pipeline/graphs"},
    "train": {"pipeline/base", "pipeline/train"},
    "evaluate": {"pipeline/base", "pipeline/train"},
}
TRAINING = {"train", "evaluate"}
# Package that stages import and that only check lists. It runs stages and prints, so an edit of it
# changes no result (import-linter: no other package of pipeline/ and models/ imports it).
JOBS = "pipeline/jobs"


def _files(dep: str) -> set[Path]:
    """Return the source files that a dep covers."""
    for name, folder in NETWORKS.items():
        if name in dep:
            return _files(folder)
    path = keys.ROOT / dep
    assert path.exists(), dep
    files = [path]
    if path.is_dir():
        files = [*path.rglob("*.py")]
    # A template imports nothing.
    return {file.relative_to(keys.ROOT) for file in files if file.suffix != ".j2"}


def test_one_name_five_places():
    """A file of stages/, an entry of dvc.yaml, a section, a folder of data/ and of pipeline/."""
    files = {path.stem for path in (keys.ROOT / "stages").glob("*.py")}
    files.remove("preset")  # runs the stages of a preset, and is none
    rooms = {path.name for path in (keys.ROOT / "pipeline").iterdir() if any(path.glob("*.py"))}
    assert files == set(STAGES) == rooms - {"base", "camera", "jobs"}
    for name, stage in STAGES.items():
        assert stage["cmd"] == f"python -m stages.{name}"  # without the syntax of a shell
        for out in _outs(stage):
            assert out.split("/")[:2] == ["data", name]


@pytest.mark.parametrize("name", STAGES)
def test_what_a_stage_imports_is_covered(name):
    files = {Path(f"stages/{name}.py")}
    if name in TRAINING:
        for folder in (*NETWORKS.values(), "models/steering/core/cell"):
            files |= _files(folder)
    for package in FOUND & {*_code(name)}:
        files |= _files(package)
    imported = _with_imports(files) - _files(JOBS)
    assert imported <= _covered(name)
    assert (_files(JOBS) <= _covered(name)) == (name == "check")
    if name in PACKAGES:
        packages = {path for package in PACKAGES[name] for path in _files(package)}
        assert _covered(name) - imported <= packages
    else:
        for dep in _code(name):
            assert _files(dep) & imported, f"{dep} is not used"


@pytest.mark.parametrize(
    ("path", "stages"),
    [
        (
            "pipeline/ingest/stored_camera.py",
            "ingest encoder perception motion scores clouds graphs report",
        ),
        ("pipeline/perception/drive_frames.py", "motion clouds graphs"),
        ("pipeline/perception/perceive.py", "perception"),
        ("pipeline/motion/speed.py", "motion"),
        ("pipeline/motion/motion_file.py", "motion labels scores train evaluate"),
        ("pipeline/labels/label_file.py", "labels scores train evaluate report"),
        ("pipeline/labels/source.py", "labels scores"),
        ("pipeline/clouds/cloud_file.py", "clouds graphs report"),
        ("pipeline/graphs/graph_file.py", "graphs train evaluate report"),
        ("pipeline/evaluate/predictions.py", "evaluate report"),
    ],
)
def test_an_edit_is_seen_by_the_stages_that_it_concerns(path, stages):
    """A new version of a layout, for instance, by the stages that write and read such files."""
    expected = {"check", *stages.split()}
    assert {name for name in STAGES if Path(path) in _covered(name)} == expected
    for name in STAGES:
        assert (path in keys.Code.read(name).loaded) == (name in expected), name


@pytest.mark.parametrize(
    ("folder", "stages"),
    [
        ("models/steering/spatial", ["train", "evaluate"]),
        ("models/steering/temporal", ["train", "evaluate"]),
        ("pipeline/ingest/datasets", ["ingest"]),
    ],
)
def test_a_network_or_dataset_imports_no_other_one_that_dvc_and_keys_do_not_see(folder, stages):
    for file in sorted((keys.ROOT / folder).glob("*.py")):
        path = file.relative_to(keys.ROOT)
        for stage in stages:
            code = keys.Code.read(stage, [str(path)]).loaded
            missing = {name for name in map(str, _with_imports({path})) if name not in code}
            assert not missing, f"{path} imports {missing}: list it in dvc.yaml, deps of {stage}"


@pytest.mark.parametrize("name", STAGES)
def test_deps_on_data_are_exactly_outs(name):
    """Depending on a parent folder of outputs would miss the order of stages; report may do so."""
    outs = {out for stage in STAGES.values() for out in _outs(stage)}
    settings = {"data/${item.source}": Variant, "data/${labels.source}": Labels}
    for dep in STAGES[name]["deps"]:
        if not dep.startswith("data/"):
            continue
        if dep in settings:
            options = get_args(settings[dep].model_fields["source"].annotation)
            assert {f"data/{source}" for source in options} <= outs
        elif name != "report" or dep not in ("data/evaluate", "data/train"):
            assert re.sub(r"\$\{item\.\w+\}", "${key}", dep) in outs


@pytest.mark.parametrize("name", STAGES)
def test_sections_that_a_stage_reads_are_its_params(name):
    tree = ast.parse((keys.ROOT / "stages" / f"{name}.py").read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    read = set()
    for module in modules:
        if re.fullmatch(r"pipeline\.\w+\.settings", module):
            read.add(module.split(".")[1])
        if module == "pipeline.train.entry":
            read.add("models")
    # check depends on the whole file; of models, report reads only names.
    expected = {"check": set(), "report": {"models", "evaluate", "ingest"}}
    listed = {param.split(".")[0] for param in STAGES[name].get("params", [])}
    assert listed == expected.get(name, read)


@pytest.mark.parametrize("source", get_args(Labels.model_fields["source"].annotation))
def test_labels_depend_on_the_folder_that_their_source_names(tmp_path, source):
    for name in ("models", "pipeline", "stages", "dvc.yaml"):
        (tmp_path / name).symlink_to(keys.ROOT / name)
    params = yaml.safe_load((keys.ROOT / "params.yaml").read_text())
    params["labels"]["source"] = source
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    dvc = Path(sys.executable).with_name("dvc")
    subprocess.run([dvc, "init", "--no-scm", "--quiet"], cwd=tmp_path, check=True)
    dot = subprocess.check_output([dvc, "dag", "--dot", "labels"], cwd=tmp_path, text=True)
    assert set(re.findall(r'"(\w+)" -> "labels"', dot)) == {"ingest", source}


def _with_imports(files: set[Path]) -> set[Path]:
    """Return files, and all files of the project that they import, directly or not."""
    found = set[Path]()
    queue = [*files]
    while queue:
        file = queue.pop()
        if file not in found and (keys.ROOT / file).is_file():
            found.add(file)
            queue += _imports(file)
    return found


def _imports(file: Path) -> set[Path]:
    """Return the modules that a file may import; "from a import b" may import a and a.b."""
    names = set[str]()
    for node in ast.walk(ast.parse((keys.ROOT / file).read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            package = ".".join([*file.parts[: -node.level], ""]) if node.level else ""
            names.add(f"{package}{node.module}")
            names.update(f"{package}{node.module}.{alias.name}" for alias in node.names)
    paths = set[Path]()
    for name in names:
        module = Path(*name.split("."))
        paths.add(module.with_suffix(".py"))
        # Python runs the __init__.py of all packages around a module.
        paths.update(folder / "__init__.py" for folder in (module, *module.parents))
    return paths


def _outs(stage: dict[str, Any]) -> list[str]:
    """Return the outputs of a stage; one with options is a mapping from its path."""
    outs = stage.get("outs", [])
    return [next(iter(out)) if isinstance(out, dict) else out for out in outs]


def _covered(name: str) -> set[Path]:
    return {path for dep in _code(name) for path in _files(dep)}


def _code(name: str) -> list[str]:
    return [
        dep for dep in STAGES[name]["deps"] if not dep.startswith("data/") and dep != "params.yaml"
    ]
