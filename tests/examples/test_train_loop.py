"""Test that examples/train_loop.py trains a network."""

import re

from examples import train_loop
from tests import artefacts


def test_the_loop_learns(tmp_path, capsys):
    drives = {f"2026_01_01_drive_000{number}": "train" for number in (1, 2, 3)}
    drives["2026_01_01_drive_0004"] = "val"
    artefacts.write_dataset(tmp_path, drives, frames=23, points=12)
    train_loop.main(tmp_path, epochs=6)

    lines = capsys.readouterr().out.splitlines()
    losses = [float(loss) for line in lines for loss in re.findall(r"loss ([\d.]+)", line)]
    errors_deg = [float(error) for line in lines for error in re.findall(r"([\d.]+)°", line)]
    assert len(losses) == len(errors_deg) == 6
    assert losses[-1] < losses[0]
    assert 0 < errors_deg[-1] < 45
