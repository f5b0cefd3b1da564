"""Test that examples/one_image.py runs, and that its steps are those of the networks."""

import runpy
from contextlib import chdir

import numpy as np
import pytest
import torch

from models.steering.core.batch import from_arrays
from pipeline.base.checkout import ROOT


@pytest.mark.slow
def test_one_image(tmp_path, capsys):
    for folder in ("examples", "models"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    with chdir(tmp_path):
        names = runpy.run_path("examples/one_image.py")
    torch.set_grad_enabled(True)
    angle_deg = names["angle_deg"]
    assert f"predicted {angle_deg:.1f}°, driven 17.1°" in capsys.readouterr().out
    assert angle_deg == pytest.approx(17.1, abs=6)

    # The network takes the same steps from the points of the last image to its features.
    arrays = {
        "xyz": names["xyz"],
        "cls": names["point_cls"],
        "ptr": np.array([0, len(names["xyz"])]),
        "degree": names["pruned"].degree,
        "indices": names["pruned"].indices,
    }
    features = names["model"].net.spatial(from_arrays(arrays))
    torch.testing.assert_close(features, names["features"][-1])
    assert (tmp_path / "out/one_image.png").read_bytes().startswith(b"\x89PNG")
