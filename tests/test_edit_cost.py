"""Which stages run again after a file was edited, by `dvc status`."""

from pathlib import Path

import pytest

from tests import scratch


@pytest.mark.slow
def test_dvc_runs_what_dvc_yaml_promises_and_no_name_as_a_command(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    leftovers = ("pipeline/train/__pycache__/fit.cpython-311.pyc", "pipeline/train/.fit.py.swp", "stages/x.py~")
    for name in leftovers:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("# an editor's")
    assert scratch.changed(folder) == set()
    edits = ("models/steering/spatial/gnn.py", "models/steering/spatial/gatv2.py", "pipeline/motion/pose.py")
    for name in edits:
        with (folder / name).open("a") as file:
            file.write("# an edit\n")
    model = scratch.MODEL
    assert scratch.changed(folder) == {"check", f"train@{model}", f"evaluate@{model}", "motion"}

    name = "x';touch pwned;'$(touch pwned)\"`touch pwned`"
    scratch.edit_params(folder, graphs={name: {"source": "clouds/pseudo", "points": 100, "k": 6}})
    output = scratch.run(folder, "dvc", "repro", "--single-item", "graphs", check=False)
    assert "error:" in output
    assert not (folder / "pwned").exists()
