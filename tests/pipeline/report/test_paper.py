from typing import Any

import pytest

from pipeline.report import paper

PLAIN: dict[str, Any] = {"equivariant": False, "alpha": 0.0, "learning_rate": None, "features": 32}
SEMANTIC = {**PLAIN, "input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 8, "cell": "ltc"}
SETS = {**PLAIN, "input": "lidar-pointnet2", "spatial": "pointnet2", "temporal": "lstm", "window": 6, "semantics": 0.0}


@pytest.mark.parametrize(
    ("settings", "network"),
    [
        ({**SEMANTIC, "semantics": 1.0}, "sa-gnn-ncp"),
        ({**SEMANTIC, "semantics": 1.0, "cell": "eq4", "features": 64}, "sa-gnn-ncp"),
        ({**SEMANTIC, "semantics": 1.0, "equivariant": True}, None),
        ({**SEMANTIC, "semantics": 1.0, "cell": "cfc"}, None),
        ({**SEMANTIC, "semantics": 1.0, "spatial": "gatv2"}, None),
        ({**SEMANTIC, "semantics": 1.0, "window": 4}, None),
        ({**SEMANTIC, "semantics": 1.0, "alpha": 5.0}, None),
        (
            {**SEMANTIC, "semantics": 1.0, "motion": "none", "horizon": 0, "fit_to": "train", "roads": None},
            "sa-gnn-ncp",
        ),
        ({**SEMANTIC, "semantics": 1.0, "roads": 6}, None),
        ({**SEMANTIC, "semantics": 1.0, "accumulate": {"motion": "visual", "frames": 8}}, None),
        ({**SEMANTIC, "semantics": 1.0, "motion": "visual"}, None),
        ({**SEMANTIC, "semantics": 1.0, "horizon": 10}, None),
        ({**SEMANTIC, "semantics": 1.0, "fit_to": "both"}, None),
        (SEMANTIC, None),  # pruned by classes that its nodes do not know
        ({**SEMANTIC, "input": "depth"}, "do-gnn-ncp"),
        ({**SEMANTIC, "input": "depth", "semantics": 1.0}, None),
        ({**SEMANTIC, "input": "lidar-50k", "temporal": "lstm", "cell": None}, "gnn-lstm"),
        ({**SETS, "width": 1.0}, "pointnet2-lstm"),
        ({**SETS, "width": 0.25}, None),
        (
            {**PLAIN, "input": "image", "spatial": "cnn", "temporal": "ncp", "cell": "ltc", "window": 16, "alpha": 5.0},
            "cnn-ncp",
        ),
    ],
)
def test_a_model_is_the_papers_by_its_settings(settings: dict[str, Any], network: str | None) -> None:
    assert paper.name(settings) == network


def test_every_network_of_the_paper_is_itself() -> None:
    for name, published in paper.PAPER.items():
        assert paper.name({key: values[0] for key, values in published.settings.items()}) == name
        assert published.train_mse < published.test_mse
