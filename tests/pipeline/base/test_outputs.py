"""The rule for a command's output: nothing that exists is replaced; a killed run is continued."""

from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.outputs import check_free, claim
from tests.kitti_drive import contents, write


@pytest.mark.parametrize(
    ("existing", "expected"),
    [
        ([], "ride"),
        (["ride/poses.txt"], "ride-2"),
        (["ride/poses.txt", "ride-2/.work/other/a.h5"], "ride-3"),
        (["ride/.work/key/a.h5"], "ride"),
        (["ride/.work/key/a.h5", "ride/poses.txt"], "ride-2"),
        (["ride-3/.work/key/a.h5"], "ride-3"),
        (["ride"], "ride-2"),
    ],
)
def test_a_command_takes_the_first_free_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, existing: list[str], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in existing:
        write(Path("out") / name, "foreign")
    before = contents(tmp_path)
    assert claim(None, "ride", "key") == Path("out") / expected
    named = Path("out/ride")
    if named.exists() and expected != "ride":
        with pytest.raises(InputError, match="Pass another --out"):
            claim(named, "ride", "key")
    else:
        assert claim(named, "ride", "key") == named
    assert contents(tmp_path) == before


def test_an_empty_folder_is_free_and_a_file_is_not(tmp_path: Path) -> None:
    check_free(tmp_path / "new.json")
    check_free(tmp_path)
    write(tmp_path / "old.json", "foreign")
    with pytest.raises(InputError, match="exists already"):
        check_free(tmp_path / "old.json")
