"""The chain, killed at random moments, ends with the bytes of a run that nobody disturbed."""

import shutil
from pathlib import Path

import pytest

from tests import kills

KILLS = 4  # python -m tests.kills 60 is the long version


@pytest.mark.slow
def test_kills_lose_nothing(tmp_path: Path) -> None:
    undisturbed = kills.small(tmp_path / "undisturbed")
    killed = Path(shutil.copytree(undisturbed, tmp_path / "killed"))
    shown = kills.kill_and_go_on(undisturbed, killed, KILLS)
    assert sum(shown.stages.values()) == KILLS
    assert shown.differing == []
    assert shown.left_over == []
