"""The examples run, and the steps of examples/one_image.py are those of the networks."""

import runpy
from contextlib import chdir

import numpy as np
import pytest
import torch

from models.steering.core.batch import from_arrays
from pipeline.base.resume import ROOT


@pytest.mark.slow
def test_one_image(tmp_path, capsys):
    for folder in ("examples", "models"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    with chdir(tmp_path):
        made = runpy.run_path("examples/one_image.py")
    torch.set_grad_enabled(True)
    assert f"predicted {made['angle_deg']:.1f}°, driven 17.1°" in capsys.readouterr().out
    assert made["angle_deg"] == pytest.approx(17.1, abs=6)
    net, points, pruned = made["model"].net, made["xyz"], made["pruned"]
    arrays = {"xyz": points, "cls": made["point_cls"], "ptr": np.array([0, len(points)])}
    features = net.spatial(
        from_arrays(arrays | {"degree": pruned.degree, "indices": pruned.indices})
    )
    torch.testing.assert_close(features, made["features"][-1])
    assert (tmp_path / "out/one_image.png").read_bytes().startswith(b"\x89PNG")
