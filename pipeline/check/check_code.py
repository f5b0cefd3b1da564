"""Find code that DVC would not watch: imports of files that settings name, and of metrics."""

from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.resume import find_imports, listed_code, with_imports
from pipeline.check.settings import Params

# The file to which users add their own metrics.
METRICS = "pipeline/evaluate/statistics.py"


def check_code(settings: Params) -> None:
    """Call :func:`check_file` for the files that the settings name."""
    for dataset in sorted(set(settings.ingest.datasets().values())):
        check_file(f"pipeline/ingest/datasets/{dataset}.py", "ingest")

    files = set[str]()
    for model in settings.models.values():
        files.update(model.files)
    for file in sorted(files):
        check_file(file, "train")

    check_file(METRICS, "evaluate")


def check_file(name: str, stage: str) -> None:
    """Raise InputError if a file imports code that dvc.yaml does not list for a stage."""
    code = listed_code(stage, [name])
    for file in sorted(with_imports([Path(name)]) & code):
        missing = find_imports(file) - code
        if missing:
            names = " and ".join(sorted(str(path) for path in missing))
            problem = (
                f"imports {names}, which dvc.yaml does not list for stage {stage}: "
                "its edits would change nothing"
            )
            fix = f"List it in dvc.yaml, deps of {stage}, or do not import it"
            raise InputError(problem, file, fix)
