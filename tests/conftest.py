"""Shared fixtures. Real data lies beside the checkout and is never part of it (KITTI is non-commercial)."""

import os
import shutil
from pathlib import Path

# The tests' networks are tiny: threads that wait for each other cost more than they bring. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from filelock import FileLock

from tests import scratch

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small chain that has run to its end, built once for all processes of pytest-xdist.

    Tests read it, or work in a copy: :func:`tests.scratch.duplicate`.
    """
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    with FileLock(root / "chain.lock"):
        if not (root / "chain.done").exists():
            shutil.rmtree(root / "chain", ignore_errors=True)
            scratch.small_chain(root / "chain")
            (root / "chain.done").touch()
    return root / "chain"


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


def _shared(name: str) -> Path:
    path = SHARED / name
    if not path.is_dir():
        pytest.skip(f"real data is absent: ../shared/{name} does not lie beside the checkout")
    return path


@pytest.hookimpl(tryfirst=True)  # before pytest selects by markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the files so that processes of pytest-xdist rarely wait.

    One file that needs the chain comes first and builds it, beside it run the tests of stages, and then the other files
    that need it.
    """
    with_chain = list(dict.fromkeys(item.path for item in items if "chain" in getattr(item, "fixturenames", ())))
    order = dict.fromkeys(with_chain, 2) | dict.fromkeys(with_chain[:1], 0)
    items.sort(key=lambda item: order.get(item.path, 1 if item.path.parent.name == "stages" else 3))
