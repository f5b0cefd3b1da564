"""One writer per stage folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.lock import exclusive
from pipeline.base.resume import ROOT

HOLDER = """
import sys
from pathlib import Path
from pipeline.base.lock import exclusive
with exclusive(Path("stage"), Path(".resume/stage")):
    print("locked", flush=True)
    sys.stdin.read()
"""


def take(tmp_path: Path) -> None:
    with exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        assert (tmp_path / ".resume/stage").is_dir()


def test_a_lock_is_released_whatever_ends_the_block(tmp_path: Path) -> None:
    take(tmp_path)
    with pytest.raises(ZeroDivisionError), exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        raise ZeroDivisionError
    take(tmp_path)
    assert not (tmp_path / "stage").exists(), "nothing is written into the stage's folder"


def test_a_second_process_is_refused_until_the_first_ends_or_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(InputError) as raised:
            take(tmp_path)
        assert raised.value.where == str(tmp_path / "stage")
        with exclusive(tmp_path / "other", tmp_path / ".resume/other"):
            pass
        holder.kill()
    take(tmp_path)


def test_a_lock_file_that_is_a_link_is_refused_and_the_file_elsewhere_stays(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("content")
    (tmp_path / ".resume").mkdir()
    (tmp_path / ".resume/stage.lock").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError) as raised:
        take(tmp_path)
    assert raised.value.where.endswith("stage.lock")
    assert (tmp_path / "precious").read_text() == "content"
