"""Define shared fixtures.

Real data lies beside the checkout and is never part of it, as KITTI is non-commercial.
"""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

# The tests' networks are tiny: threads that wait for each other, and processes that import torch,
# cost more than they bring. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("STEER_WORKERS", "1")

import pytest
from hypothesis import settings

# A busy machine takes seconds for an example that takes milliseconds elsewhere.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

SHARED = Path(__file__).resolve().parents[2] / "shared"


def _real(name: str) -> Callable[[], Path]:
    """Return the fixture of a folder of real data; without it, tests that use it are skipped."""

    @pytest.fixture(scope="session")
    def folder() -> Path:
        if not (SHARED / name).is_dir():
            pytest.skip(f"real data is absent: ../shared/{name} does not lie beside the checkout")
        return SHARED / name

    return folder


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of the code, which cache keys read instead of the project's."""
    from pipeline.jobs import keys

    folder = tmp_path / "checkout"
    for name in keys.PACKAGES:
        shutil.copytree(keys.ROOT / name, folder / name)
    shutil.copy(keys.ROOT / "dvc.yaml", folder)
    monkeypatch.setattr(keys, "ROOT", folder)
    monkeypatch.setattr(keys, "LOADED", keys.scan_code())
    return folder


@pytest.fixture(params=["cpu", "cuda"])
def device(request: pytest.FixtureRequest) -> str:
    """Return each device; tests on a GPU are skipped without one."""
    import torch

    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    return str(request.param)


real_kitti = _real("kitti")  # a few drives in KITTI's layout
real_half = _real("kitti_half")  # drives that turn, at half size
real_weights = _real("weights")  # published weights of backbones, a folder for each
real_cases = _real("cases/round7")  # recordings as public reports describe them
real_camvid = _real("camvid")  # test images and labels


@pytest.hookimpl(tryfirst=True)  # before pytest selects by markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the chain first, then stages and steer: a process of pytest-xdist takes a file."""

    def rank(item: pytest.Item) -> int:
        if item.path.stem == "test_chain":
            return 0
        if item.path.parent.name in ("stages", "steer"):
            return 1
        return 2

    items.sort(key=rank)
