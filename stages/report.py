"""Put the evaluated models side by side: data/report/table.md."""

from pathlib import Path
from typing import Any

from pipeline import console, store
from pipeline.params import names

HEADER = (
    "test nmse", "95 % interval", "MSE rad²", "mean error deg", "train / val nmse", "parameters", "edges per frame",
    "ms per frame",
)  # fmt: skip
READING = (
    "nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect. *zero*, *train_mean* and *persistence* "
    "see no road; persistence is told the true angle of the frame before, which no model is."
)
PAPER_UNIT = (
    "The paper's Table 2 gives errors of 0.077 to 0.268 rad². By its own label, always predicting zero has 0.0137 rad² "
    "on KITTI's longest drive, so that unit cannot be rad² of this label: compare with the paper by order and ratio."
)


def main(
    evaluate: Path = Path("data/evaluate"), out: Path = Path("data/report"), params: Path = Path("params.yaml")
) -> None:
    """Write table.md: each model of the params file on the test drives, then the trivial predictors."""
    results, absent = {}, []
    for model in names("models", params):
        if (evaluate / model / "metrics.json").is_file():
            results[model] = store.read_json(evaluate / model / "metrics.json", stage=f"evaluate@{model}")
        else:
            absent.append(model)
    text = table(results, absent)
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text(text, encoding="utf-8")
    print(text)


def table(results: dict[str, Any], absent: list[str]) -> str:
    """Return the table as Markdown; `absent` models are named with the command that gets them."""
    lines = [" | ".join(["| model", *HEADER]) + " |", "|" + "---|" * (len(HEADER) + 1)]
    for model, result in results.items():
        test = result["test"]
        other = [f"{result[split]['nmse']:.3f}" if result[split] else "none" for split in ("train", "val")]
        edges = result["edges_per_frame"]
        cells = [
            f"{test['nmse']:.3f}", "{:.3f} to {:.3f}".format(*test["nmse_ci95"]), f"{test['mse_rad2']:.5f}",
            f"{test['mae_deg']:.2f}", " / ".join(other), f"{result['parameters']:,}",
            "none" if edges is None else f"{edges:.0f}", f"{result['encode_ms_per_frame']:.2f}",
        ]  # fmt: skip
        lines.append(f"| {model} | {' | '.join(cells)} |")
    first = next(iter(results.values()), None)
    for baseline, scores in first["test"]["baselines"].items() if first else ():
        cells = [f"{scores['nmse']:.3f}", "", f"{scores['mse_rad2']:.5f}", f"{scores['mae_deg']:.2f}", "", "", "", ""]
        lines.append(f"| *{baseline}* | {' | '.join(cells)} |")
    if first:
        drives = ", ".join(first["drives"]["test"])
        lines += ["", f"Test: {first['test']['frames']} valid frames of {drives}. {READING}"]
    for model in absent:
        lines += ["", f"{model} is not evaluated on this machine: dvc pull evaluate@{model}, or dvc repro."]
    return "\n".join([*lines, "", PAPER_UNIT, ""])


if __name__ == "__main__":
    console.run(main)
