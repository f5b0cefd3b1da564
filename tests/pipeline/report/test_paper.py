"""A model is one of the paper's networks by its settings."""

from typing import Any

import pytest

from pipeline.report import paper

SEMANTIC = {
    "equivariant": False, "alpha": 0.0, "learning_rate": None, "features": 32, "input": "semantic", "spatial": "gnn",
    "temporal": "ncp", "window": 8, "cell": "ltc", "semantics": 1.0, "motion": "none", "horizon": 0, "fit_to": "train",
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "network"),
    [
        ({}, "sa-gnn-ncp"),
        ({"cell": "eq4", "features": 64}, "sa-gnn-ncp"),
        ({"cell": "cfc"}, None),
        ({"window": 4}, None),
        ({"accumulate": True}, None),
        ({"semantics": 0.0}, None),
        ({"input": "depth", "semantics": 0.0}, "do-gnn-ncp"),
    ],
)
def test_a_change_of_a_compared_setting_makes_another_network(change: dict[str, Any], network: str | None) -> None:
    assert paper.name({**SEMANTIC, **change}) == network


def test_every_network_of_the_paper_is_found() -> None:
    for name, published in paper.PAPER.items():
        assert paper.name({key: values[0] for key, values in published.settings.items()}) == name
        assert published.train_mse < published.test_mse
