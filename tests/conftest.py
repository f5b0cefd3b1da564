"""Shared fixtures. Real data lies beside the checkout and is never part of it (KITTI is non-commercial)."""

import os
from pathlib import Path

# The tests' networks are tiny: threads that wait for each other cost more than they bring. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def real_kitti() -> Path:
    """A few real KITTI drives in KITTI's layout; the test is skipped where they are absent."""
    return _shared("kitti")


@pytest.fixture(scope="session")
def real_half() -> Path:
    """Real KITTI drives that turn, at half size, in KITTI's layout; the test is skipped where they are absent."""
    return _shared("kitti_half")


@pytest.fixture(scope="session")
def real_weights() -> Path:
    """Published weights of backbones, a folder for each; the test is skipped where they are absent."""
    return _shared("weights")


@pytest.fixture(scope="session")
def real_camvid() -> Path:
    """CamVid's test images and labels; the test is skipped where they are absent."""
    return _shared("camvid")


def _shared(name: str) -> Path:
    path = SHARED / name
    if not path.is_dir():
        pytest.skip(f"real data is absent: ../shared/{name} does not lie beside the checkout")
    return path


@pytest.hookimpl(tryfirst=True)  # before pytest selects by markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the chain first, and beside it the stages: the longest files, one process of pytest-xdist each."""
    items.sort(key=lambda item: (item.path.stem != "test_chain", item.path.parent.name not in ("stages", "steer")))
