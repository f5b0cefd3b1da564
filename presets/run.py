"""Run a preset in a copy of the code, runs/NAME, a DVC repository with its own cache: ``make NAME``."""

import json
import shutil
import signal
import subprocess
from pathlib import Path

import typer

from pipeline.base import console
from pipeline.base.outputs import locked
from pipeline.base.params import read
from pipeline.base.resume import CODE, file_hash, revision
from pipeline.base.store import write_json
from pipeline.settings import preset

DVC = ("config cache.type hardlink,copy", "cache dir .dvc/cache", "repro")


def main(name: str) -> None:
    """Run preset `name` and copy its report to data/report/NAME.*. Raises InputError if it is running already."""
    run, report = Path("runs") / name, Path("data/report")
    for folder in (run / "data", report, Path("weights")):
        folder.mkdir(parents=True, exist_ok=True)
    with locked(run, f"{run}.lock"):
        copy_code(run)
        preset.main(name, run)
        for place, target in ((run / "data/raw", "../../../data/raw"), (run / "weights", "../../weights")):
            place.unlink(missing_ok=True)
            place.symlink_to(target)
        signal.signal(signal.SIGINT, lambda *_: None)  # DVC ends by itself; killed, it would leave locks
        for words in (*["init --quiet --no-scm"][(run / ".dvc").is_dir() :], *DVC):
            if status := subprocess.run(["dvc", *words.split()], cwd=run, check=False).returncode:
                raise typer.Exit(status)
        for source, suffix in (("index.html", "html"), ("table.md", "md")):
            shutil.copyfile(run / "data/report" / source, report / f"{name}.{suffix}")
    print((report / f"{name}.md").read_text(encoding="utf-8"), f"Open {report}/{name}.html in a browser.", sep="")
    settings = read(run / "params.yaml")
    for part in [*settings["ingest"].get("recordings", {}).values()][:1]:
        lens = [f"--{key} {part[key]}" for key in ("fov", "K", "distortion", "fisheye") if key in part]
        print("next: steer predict VIDEO", *lens, f"--model {run}/data/train/{next(iter(settings['models']))}")
        recorded = json.loads((run / "data/scores/metrics.json").read_text(encoding="utf-8"))["recorded"]
        for doubt in dict.fromkeys(line for log in recorded.values() for line in log["lines"][1:]):
            print(f"doubt: {doubt}")


def copy_code(run: Path) -> None:
    """Copy the code; if it differs from the last copy, keep dvc.lock, which names its results, as dvc.lock.before.

    copied.json lists the files with their hashes: only these are removed where the code no longer has them. The file
    `revision` names the commit, for docs/make_results.py.
    """
    listed, lock = run / "copied.json", run / "dvc.lock"
    before = json.loads(listed.read_text(encoding="utf-8")) if listed.exists() else {}
    paths = [file for name in CODE for file in ([Path(name)] if Path(name).is_file() else Path(name).rglob("*.*"))]
    now = {str(path): file_hash(path) for path in paths if path.is_file() and path.suffix != ".pyc"}
    if now != before and lock.exists():
        shutil.copyfile(lock, run / "dvc.lock.before")
    for name in before.keys() - now.keys():
        (run / name).unlink(missing_ok=True)
    for name in now:
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(name, run / name)
    write_json(listed, now)
    (run / "revision").write_text(revision(), encoding="ascii")


if __name__ == "__main__":
    console.run(main)
