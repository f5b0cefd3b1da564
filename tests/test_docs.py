"""Test the Markdown pages: their number, size and width, and links to files and headings that exist."""

import re
from pathlib import Path
from typing import Any

import pytest
from torch.utils.data import DataLoader

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.settings.ingest import Ingest
from pipeline.settings.models import Entry
from pipeline.settings.sample import Sample
from tests import artefacts, scratch

PAGES = [ROOT / "README.md", ROOT / "data/README.md"] + [
    ROOT / f"docs/{name}.md" for name in ("models", "paper", "real", "results", "running")
]
TEXTS = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "docs/log.md"]
LINK = re.compile(r"\[[^\]]*\]\(([^)]+)\)")


def headings(page: Path) -> set[str]:
    """Return the anchors of a page as GitHub names them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for link in LINK.findall(page.read_text()):
        name, _, anchor = link.partition("#")
        if not name.startswith(("http://", "https://")):
            target = (page.parent / name).resolve() if name else page
            assert target.exists(), link
            assert not anchor or anchor in headings(target), link


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_prose_has_at_most_110_columns(page: Path) -> None:
    prose = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    wide = [line for line in prose.splitlines() if len(line) > 110 and not line.startswith(("|", "!"))]
    assert wide == []


def test_there_are_seven_short_pages() -> None:
    assert {*(ROOT / "docs").glob("*.md")} == {*PAGES[2:], ROOT / "docs/log.md"}
    assert sum(len(page.read_text().splitlines()) for page in PAGES) <= 850
    assert len(PAGES[0].read_text().splitlines()) <= 120


def test_examples_name_drives_and_frames_of_the_sample() -> None:
    texts = [(ROOT / name).read_text() for name in ("README.md", "pipeline/train/predict.py", "steer/show.py")]
    drives = load(Ingest, ROOT / "params.yaml").drives.splits()
    last = load(Sample, ROOT / "params.yaml").frames.test - 1
    for text in texts:
        named = re.findall(r"2026_\d\d_\d\d_drive_\d{4}", text)
        assert named
        assert {*named} <= {*drives}
        frames = re.findall(r"--frame (\d+)|predict\(graphs, \[([\d, ]+)\]", text)
        assert all(int(number) <= last for groups in frames for part in groups if part for number in part.split(","))


def test_the_dataset_of_the_documentation_yields_each_window_once(tmp_path: Path) -> None:
    drives = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
    artefacts.write_dataset(tmp_path, drives, frames=23, points=12)
    names: dict[str, Any] = {}
    exec(scratch.code_block("class Windows(Dataset)").removeprefix("python\n"), names)
    dataset = names["Windows"](tmp_path / "graphs/semantic", tmp_path / "labels", [*drives])
    batches = [*DataLoader(dataset, batch_size=None)]
    assert len(batches) == 2 * (23 - 7)
    entry = {"input": "semantic", "spatial": "gnn", "temporal": "lstm", "semantics": 1.0}
    net = Entry.model_validate(entry).build("graph")
    for batch in batches:
        assert batch["ptr"].shape == (9,)
        assert batch["dt_s"].shape == (1, 8)
        assert batch["target"].shape == batch["valid"].shape == (1, 1)
        assert net(*net.inputs(batch)).isfinite().all()
