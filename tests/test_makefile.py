"""Test the Makefile: presets with a DVC that only logs its calls."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from filelock import FileLock

from pipeline.jobs.revision import revision

from pipeline.base.checkout import ROOT, in_checkout
from pipeline.base.errors import InputError
from pipeline.base.hashes import file_hash
from pipeline.encoder import create
from pipeline.encoder.settings import Encoder
from pipeline.encoder.weights import weights_hash
from stages import preset
from tests.kitti_drive import contents, write
from tests.pipeline.base.test_base import files_up_to

DVC = """#!/bin/sh
echo "$@" >> {log}
case "$1" in
init) mkdir .dvc ;;
stage) echo train@fails train@works | tr ' ' '\\n' ;;
--wait-for-lock)
  case "$4" in train@fails) echo "$4: loss is nan" >&2; exit 255 ;; esac
  sleep 0.5; echo "made $4 $5" >> {log} ;;
repro)
  mkdir -p data/report && ls stages > dvc.lock
  [ ! -e stages/broken.py ] || exit 255
  echo "<h1>Steering report</h1>" > data/report/index.html
  echo {{}} > data/report/results.json
  echo "| $(basename "$PWD") |" > data/report/table.md ;;
esac
"""
PYTHON = '#!/bin/sh\nexec "{python}" "$@"\n'


@pytest.fixture
def checkout(tmp_path) -> Path:
    """Return a copy of the project with this python and a dvc that only logs."""
    folder = tmp_path / "checkout"
    for name in ("pipeline", "models", "stages", "presets"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "params.yaml", "dvc.yaml", ".dvcignore", "data/.gitignore"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    (folder / "fake/bin").mkdir(parents=True)
    for name, text in {"python": PYTHON, "dvc": DVC}.items():
        path = folder / "fake/bin" / name
        path.write_text(text.format(log=folder / "calls", python=sys.executable))
        path.chmod(0o755)
    return folder


def make(checkout: Path, target: str) -> subprocess.CompletedProcess[str]:
    """Run make without the target setup, which would install packages."""
    environment = dict(os.environ)
    for name in ("PYTHONPATH", "MAKEFLAGS"):
        environment.pop(name, None)
    command = ["make", "-o", "setup", "VENV=fake", target]
    return subprocess.run(
        command, cwd=checkout, env=environment, capture_output=True, text=True, check=False
    )


def test_preset_quick_trains_each_model_for_two_epochs(tmp_path):
    """Also models of your own, in place of those of the project."""
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    content["models"] = {"mine": content["models"]["sa-gnn-ncp"] | {"epochs": 12}}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    settings = preset.merge_preset("quick", tmp_path / "params.yaml")
    assert {name: entry["epochs"] for name, entry in settings["models"].items()} == {"mine": 2}
    assert settings["ingest"]["source"] == "sample"


@pytest.mark.slow
def test_a_preset_runs_in_a_copy_of_the_code(checkout):
    """Also where `runs` is on another disk."""
    params = (checkout / "params.yaml").read_text()
    (checkout.parent / "disk").mkdir()
    (checkout / "runs").symlink_to(checkout.parent / "disk")
    done = make(checkout, "kitti")
    assert done.returncode == 0, done.stderr
    assert "\npreset kitti, revision unknown, date 20" in done.stdout
    assert (checkout / "calls").read_text().splitlines() == [
        "init --quiet --no-scm",
        "config cache.type hardlink,copy",
        "cache dir .dvc/cache",
        "repro",
    ]

    run = checkout / "runs/kitti"
    assert yaml.safe_load((run / "params.yaml").read_text()) == preset.merge_preset("kitti")
    code = ("pipeline/labels/label.py", "pipeline/jobs/runner.py")
    for copied in ("dvc.yaml", ".dvcignore", "data/.gitignore", *code):
        assert (run / copied).read_bytes() == (ROOT / copied).read_bytes()
    assert (run / "checkout").read_text() == str(checkout)
    settings = json.loads((run / "run.json").read_text())["settings"]
    assert settings["ingest"]["source"] == "kitti"
    assert (checkout / "params.yaml").read_text() == params

    report = checkout / "data/report"
    assert (report / "kitti.md").read_text() == "| kitti |\n"
    assert (report / "kitti.html").read_text() == "<h1>Steering report</h1>\n"
    results = json.loads((report / "kitti.json").read_text())
    assert (results["preset"], results["results"]) == ("kitti", {})

    # A failing run publishes nothing. The next one drops files that the code no longer has.
    (checkout / "stages/labels.py").rename(checkout / "stages/broken.py")
    (report / "kitti.md").unlink()
    assert make(checkout, "kitti").returncode != 0
    assert "kiti: no such preset or target. Presets: k" in make(checkout, "kiti").stderr
    assert not (report / "kitti.md").exists()
    (checkout / "stages/broken.py").rename(checkout / "stages/repaired.py")
    assert make(checkout, "kitti").returncode == 0
    assert not (run / "stages/labels.py").exists()

    # What a user wrote to the copy stays, also while another process runs it.
    (run / "pipeline/mine.py").write_text("mine")
    done = make(checkout, "kitti")
    assert "runs/kitti/pipeline/mine.py: was edited" in done.stderr
    with FileLock(checkout / "runs/kitti.lock"):
        done = make(checkout, "kitti")
    assert "runs/kitti: another process is writing it" in done.stderr
    assert (run / "pipeline/mine.py").read_text() == "mine"


RUN = '{"files": {"params.yaml": "hash"}}'
REFUSED = [
    ("table", {"presets/table.yaml": "train: {}"}, "table: is the name of a file that stage"),
    ("roads", {"runs/roads/dvc.yaml": "mine"}, "runs/roads: exists already and holds dvc.yaml"),
    (
        "roads",
        {"runs/roads/run.json": RUN, "runs/roads/params.yaml": "a: 1"},
        "runs/roads/params.yaml: was edited",
    ),
    ("demo", {"presets/demo.yaml": "train: {}"}, "demo: is a target of make"),
    ("kiti", {}, "no preset 'kiti'. Known: encoder, kitti, "),
    ("mine", {"presets/mine.yaml": "encoder: {weights: no.pt}"}, "no.pt: file is missing"),
]


@pytest.mark.parametrize(("name", "files", "problem"), REFUSED)
def test_a_run_that_would_replace_other_files_or_mix_settings_is_refused(
    checkout, monkeypatch, name, files, problem
):
    monkeypatch.chdir(checkout)
    monkeypatch.setattr(preset, "PRESETS", checkout / "presets")
    for file, text in files.items():
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_text(text)
    with pytest.raises(InputError, match=problem):
        preset.main(name, None)
    for file, text in files.items():
        assert Path(file).read_text() == text
    assert not Path("calls").exists()


def test_a_report_replaces_the_last_one_completely_or_not_at_all(tmp_path):
    run = tmp_path / "run"
    report = tmp_path / "report"
    write(run / "run.json", '{"revision": "abc", "started_s": 0}')
    write(run / "data/report/results.json", "{}")
    write(run / "data/report/index.html", "<h1>first</h1>")
    write(run / "data/report/table.md", "first")
    preset.publish_report(run, report, "kitti")
    first = contents(report)
    assert {*first} == {"kitti.html", "kitti.md", "kitti.json"}

    for page, table, results in ((9000, 9, 9), (9, 9000, 9), (9, 9, 9000)):
        write(run / "data/report/index.html", "<" * page)
        write(run / "data/report/table.md", "|" * table)
        write(run / "data/report/results.json", json.dumps("9" * results))
        with pytest.raises(OSError, match="report/kitti"), files_up_to(5000):
            preset.publish_report(run, report, "kitti")
        assert contents(report) == first


def test_a_run_takes_weights_from_its_checkout(tmp_path, monkeypatch):
    """By path: a folder without links, on any disk."""
    (tmp_path / "checkout").mkdir()
    (tmp_path / "checkout/encoder.pt").write_text("weights")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/checkout").write_text(f"{tmp_path}/checkout")
    monkeypatch.chdir(tmp_path / "run")
    encoder = preset.merge_preset("roads")["encoder"] | {"weights": "encoder.pt"}
    create.check_encoder(Encoder(**encoder))
    assert weights_hash(Encoder(**encoder)) == file_hash(tmp_path / "checkout/encoder.pt")
    assert in_checkout(tmp_path / "elsewhere") == tmp_path / "elsewhere"


@pytest.mark.parametrize(
    ("encoder", "file"),
    [
        ({"weights": "encoder.pt"}, "encoder.pt"),
        ({"backbone": "precomputed", "weights": "pngs"}, "pngs/drive/cls/0.png"),
        ({"backbone": "hugging_face", "weights": None, "model": "net", "epochs": 1}, "net/a.bin"),
        ({"backbone": "street", "weights": None}, ""),
    ],
)
def test_other_files_of_an_encoder_under_the_same_name_change_its_settings(
    tmp_path, monkeypatch, encoder, file
):
    monkeypatch.chdir(tmp_path)
    settings = preset.merge_preset("roads")["encoder"] | encoder
    if not file:
        assert weights_hash(Encoder(**settings)) is None
        return
    write(Path(file), "first")
    first = weights_hash(Encoder(**settings))
    write(Path(file), "second")
    assert weights_hash(Encoder(**settings)) not in (None, first)
    with pytest.raises(InputError, match=r"hash of other weights\. Repeat make NAME"):
        create.create_encoder(Encoder(**settings, weights_sha256=first))


@pytest.mark.slow
def test_the_demo_ends_all_trainings_before_it_shows_a_failure(checkout):
    """Without git, as in GitHub's ZIP; DVC's exit status 255 would end xargs at once."""
    done = make(checkout, "demo")
    assert done.returncode != 0
    calls = (checkout / "calls").read_text().splitlines()
    assert calls[0] == "config --local core.no_scm true"
    assert calls[-1] == "made train@works evaluate@works"
    assert "train@fails: loss is nan" in done.stderr


def test_a_revision_names_the_commit_and_edits_of_the_code(tmp_path):
    assert revision(tmp_path) == ""
    (tmp_path / "dvc.yaml").write_text("stages: {}")
    for words in ("init -q", "add .", "-c user.name=a -c user.email=a commit -qm a"):
        subprocess.run(["git", *words.split()], cwd=tmp_path, check=True)
    commit = revision(tmp_path)
    assert re.fullmatch("[0-9a-f]{7}", commit)
    (tmp_path / "results.json").touch()
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets/monday.yaml").touch()
    assert revision(tmp_path) == commit
    (tmp_path / "dvc.yaml").write_text("stages: {a: }")
    assert revision(tmp_path) == f"{commit}-dirty"
