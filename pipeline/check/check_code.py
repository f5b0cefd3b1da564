"""Find code that DVC would not watch: imports of networks, datasets, label sources and metrics."""

from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.resume import find_imports, listed_code, with_imports
from pipeline.check.settings import Params

METRICS = "pipeline/evaluate/statistics.py"


def check_code(settings: Params) -> None:
    """Raise InputError if a file that `settings` name imports code that dvc.yaml does not list for
    its stage.
    """
    datasets = {
        f"pipeline/ingest/datasets/{name}.py" for name in settings.ingest.datasets().values()
    }
    networks = {file for model in settings.models.values() for file in model.networks}
    source = f"pipeline/labels/sources/{settings.labels.source}.py"
    files = {
        "ingest": datasets,
        "labels": {source},
        "scores": {source},
        "train": networks,
        "evaluate": {METRICS},
    }
    for stage, names in files.items():
        for name in sorted(names):
            check_file(name, stage)


def check_file(name: str, stage: str) -> None:
    """Raise InputError if a file imports code that dvc.yaml does not list for a stage."""
    code = listed_code(stage, [name])
    for file in sorted(with_imports([Path(name)]) & code):
        missing = find_imports(file) - code
        if missing:
            names = " and ".join(sorted(map(str, missing)))
            problem = (
                f"imports {names}, which dvc.yaml does not list for stage {stage}: its edits "
                "would change nothing"
            )
            raise InputError(
                problem, file, f"List it in dvc.yaml, deps of {stage}, or do not import it"
            )
