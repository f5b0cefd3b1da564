"""Run a preset in a copy of the code, runs/NAME, a DVC repository with its own cache: ``make NAME``."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from datetime import date
from html import escape
from pathlib import Path
from typing import Any

import typer
import yaml

from pipeline.base import console
from pipeline.base.outputs import locked
from pipeline.base.params import read
from pipeline.base.resume import CODE, file_hash, revision
from pipeline.base.store import write_json
from pipeline.check import preset

DVC = ("config cache.type hardlink,copy", "cache dir .dvc/cache", "repro")


def main(name: str) -> None:
    """Run preset `name` and copy its report to data/report/NAME.*. Raises InputError if it is running already."""
    run, report, start_s = Path("runs") / name, Path("data/report"), time.monotonic()
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
        made = origin(name, (run / "revision").read_text("ascii"))
        took = f"{(time.monotonic() - start_s) / 60:.1f} min of the last make"
        facts, settings = ", ".join([*map(" ".join, made.items()), took]), read(run / "params.yaml")
        content = json.loads((run / "data/report/results.json").read_text(encoding="utf-8"))
        write_json(report / f"{name}.json", made | {"results": content}, sort_keys=False)
        command, page = next_command(name, run, settings), (run / "data/report/index.html").read_text(encoding="utf-8")
        page = with_facts(page, facts, changes(settings, read(Path("params.yaml"))), command)
        (report / f"{name}.html").write_text(page, encoding="utf-8")
        shutil.copyfile(run / "data/report/table.md", report / f"{name}.md")
    print((report / f"{name}.md").read_text(encoding="utf-8"), f"Open {report}/{name}.html in a browser.", sep="")
    print(facts, f"next: {command}", sep="\n")
    if settings["ingest"].get("recordings"):
        recorded = json.loads((run / "data/scores/metrics.json").read_text(encoding="utf-8"))["recorded"]
        for doubt in dict.fromkeys(line for log in recorded.values() for line in log["lines"][1:]):
            print(f"doubt: {doubt}")


def next_command(name: str, run: Path, settings: dict[str, Any]) -> str:
    """Return the command after a run: a prediction with the lens of a recording, or the next run."""
    drives, recordings = settings["ingest"]["drives"], settings["ingest"].get("recordings", {})
    for part in [recordings[drive] for drive in drives["test"] if drive in recordings]:
        lens = [f"--{key} {part[key]}" for key in ("fov", "K", "distortion", "fisheye") if key in part]
        return " ".join(["steer predict VIDEO", *lens, f"--model {run}/data/train/{next(iter(settings['models']))}"])
    return f"$EDITOR presets/{name}.yaml && make {name}  # trains only what changed"


def changes(new: dict[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Return what differs in nested settings, as a preset: None for a key that `new` lacks."""
    both = {key: (new.get(key), old.get(key)) for key in {**old, **new} if new.get(key) != old.get(key)}
    return {key: changes(a, b) if isinstance(a, dict) and isinstance(b, dict) else a for key, (a, b) in both.items()}


def with_facts(page: str, facts: str, settings: dict[str, Any], command: str) -> str:
    """Return the page of a stage with what the stage cannot know: where it comes from, and the next command."""
    text = yaml.safe_dump(settings, allow_unicode=True, sort_keys=False)
    summary = f"<summary>{escape(facts)}; settings that differ from params.yaml</summary>"
    page = page.replace("</h1>", f"</h1>\n<details>{summary}<pre>{escape(text)}</pre></details>", 1)
    return re.sub("(?<=Next: <code>).*(?=</code>)", lambda _: escape(command), page)


def copy_code(run: Path) -> None:
    """Copy the code; if it differs from the last copy, keep dvc.lock, which names its results, as dvc.lock.before.

    copied.json lists the files with their hashes: only these are removed where the code no longer has them. The file
    `revision` names the commit.
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


def origin(preset: str, commit: str) -> dict[str, str]:
    """Return what docs/results keeps of a run beside its results."""
    from torch import cuda

    machine = cuda.get_device_name() if cuda.is_available() else f"{os.cpu_count()} CPU cores"
    return {"preset": preset, "revision": commit or "unknown", "date": str(date.today()), "machine": machine}


if __name__ == "__main__":
    console.run(main)
