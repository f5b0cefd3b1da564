from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmarks import keep_rule
from pipeline.base.errors import InputError
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[2] / "params.yaml"
SPLITS = {f"2026_01_0{day}_drive_000{number}": split for day, split in ((1, "train"), (2, "val")) for number in (1, 2)}


def test_each_half_chooses_and_the_other_judges() -> None:
    first, second = [0.5, 0.2, 0.4, 0.3], [0.9, 0.8, 0.6, 0.5]  # nmse of two drives in four epochs
    squares = np.array([[[a, 1.0], [b, 1.0]] for a, b in zip(first, second, strict=True)])
    found = keep_rule.judged(squares)
    assert found["best"] == pytest.approx(((second[1] + first[3]) / 2, (2 + 4) / 2))
    assert found["last"] == pytest.approx(((second[3] + first[3]) / 2, 4))
    assert found["smoothed"] == pytest.approx(((second[3] + first[3]) / 2, 4))  # 0.5, 0.35, 0.37, 0.3
    assert found[keep_rule.BY_CHANCE] == pytest.approx(((second[3] + first[1]) / 2, (4 + 2) / 2))


def test_the_table_has_differences_between_seeds() -> None:
    seeds = [{"best": (0.2, 3.0), "last": (0.1, 8.0)}, {"best": (0.4, 5.0), "last": (0.2, 8.0)}]
    lines = keep_rule.table(seeds, 8).splitlines()
    assert lines[2] == "| best | 0.3000 | 0.1414 | 0.2000 to 0.4000 | +0.0000 ± 0.0000 | 4.0 of 8 |"
    assert lines[3] == "| last | 0.1500 | 0.0707 | 0.1000 to 0.2000 | -0.1500 ± 0.0500 | 8.0 of 8 |"


@pytest.mark.slow
def test_it_trains_and_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    artefacts.write_dataset(tmp_path, SPLITS, frames=30, points=30)
    content = yaml.safe_load(PARAMS.read_text())
    line = {"input": "semantic", "spatial": "gnn", "temporal": "lstm", "window": 4, "features": 8, "layers": [8]}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content | {"models": {"net": line}}))
    keep_rule.main("net", tmp_path, tmp_path / "params.yaml", seeds=2, epochs=3, workers=1)
    printed = capsys.readouterr().out
    assert all(f"| {rule} |" in printed for rule in keep_rule.RULES)
    assert "8.0 of 8" not in printed
    assert "3.0 of 3" in printed


def test_a_single_validation_drive_cannot_choose_and_judge(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, dict(list(SPLITS.items())[:3]), frames=12, points=20)
    with pytest.raises(InputError, match="has 1 validation drives: half of them choose"):
        keep_rule.errors(0, "sa-gnn-ncp", tmp_path, PARAMS, 3)
