"""``make NAME``: run a preset in runs/NAME, a copy of the code with its own DVC cache."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import typer

from pipeline.base import console
from pipeline.base.checkout import CHECKOUT
from pipeline.base.errors import InputError
from pipeline.base.outputs import locked
from pipeline.base.params import parse, read_yaml
from pipeline.base.resume import CODE, revision
from pipeline.base.store import write_json, write_text
from pipeline.check import preset
from pipeline.encoder.settings import Encoder
from pipeline.encoder.weights import weights_hash
from pipeline.report.origin import RUN, duration, origin, read_run

DVC = ("config cache.type hardlink,copy", "cache dir .dvc/cache", "repro")


def main(name: str) -> None:
    """Run preset `name` and copy its report to data/report/NAME.*. Raises InputError if it is
    running already.
    """
    run = Path("runs") / name

    # Nothing is written before all settings are known.
    preset.check_name_is_free(name)
    params = preset.base_of(name, Path("params.yaml"))
    settings = preset.merged(name, params)
    preset.take_logs(settings, Path("data/raw"))
    take_weights(settings["encoder"], run / "params.yaml")

    run.parent.mkdir(exist_ok=True)
    with locked(run, f"{run}.lock"):
        check_is_run(run)
        made = {
            "preset": name,
            "revision": revision(),
            "started_s": time.time(),
            "settings": changes(settings, read_yaml(params)),
            "next": next_command(name, run, settings),
        }
        write_json(run / RUN, made, sort_keys=False)
        write_text(run / CHECKOUT, str(Path.cwd()))
        preset.write(settings, run / "params.yaml", f"make {name}")
        copy_code(run)
        release_locks(run / ".dvc/tmp/rwlock")
        run_dvc(run)
        publish(run, Path("data/report"), name)
    print(f"Open data/report/{name}.html in a browser.", f"next: {made['next']}", sep="\n")
    if settings["ingest"].get("recordings"):
        recorded = json.loads((run / "data/scores/metrics.json").read_text("utf-8"))["recorded"]
        for doubt in dict.fromkeys(line for log in recorded.values() for line in log["lines"][1:]):
            print(f"doubt: {doubt}")


def publish(run: Path, report: Path, name: str) -> None:
    """Copy the page, the table and the results of a run to files NAME.*, and print the table."""
    results = json.loads((run / "data/report/results.json").read_text(encoding="utf-8"))
    made = origin(run)
    write_json(report / f"{name}.json", made | {"results": results}, sort_keys=False)
    for source, suffix in {"index.html": "html", "table.md": "md"}.items():
        text = (run / "data/report" / source).read_text(encoding="utf-8")
        write_text(report / f"{name}.{suffix}", text)
    facts = [*map(" ".join, made.items()), f"{duration(read_run(run))} of the last make"]
    print(text, ", ".join(facts), sep="\n")


def check_is_run(run: Path) -> None:
    """Raise InputError if a folder has files, but none by an earlier run."""
    if run.exists() and any(run.iterdir()) and not (run / RUN).exists():
        raise InputError("is a folder that no run made", run, "Move it away, or rename the preset")


def take_weights(encoder: dict[str, Any], params: Path) -> None:
    """Add the hash of the weights to section encoder, so that DVC notices a file that was replaced.

    A missing file keeps the hash that the run's `params` have of it: results of an earlier run need
    no weights.
    """
    earlier = read_yaml(params).get("encoder", {}) if params.is_file() else {}
    same_file = earlier.get("weights") == encoder.get("weights")
    if same_file and "weights_sha256" in earlier and not Path(encoder["weights"]).exists():
        encoder["weights_sha256"] = earlier["weights_sha256"]
        return
    found = weights_hash(parse(Encoder, encoder, "encoder"))
    if found:
        encoder["weights_sha256"] = found


def copy_code(run: Path) -> None:
    """Copy the code. copied.json lists the files: only these are removed where the code no longer
    has them.
    """
    listed = run / "copied.json"
    before = set(json.loads(listed.read_text(encoding="utf-8"))) if listed.exists() else set()
    paths = [
        file
        for name in CODE
        for file in ([Path(name)] if Path(name).is_file() else Path(name).rglob("*.*"))
    ]
    now = {str(path) for path in paths if path.is_file() and path.suffix != ".pyc"}
    for name in before - now:
        (run / name).unlink(missing_ok=True)
    for name in now:
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(name, run / name)
    write_json(listed, sorted(now))


def release_locks(path: Path) -> None:
    """Remove the entries of DVC's lock file whose process is not the one that wrote them.

    DVC keeps them while any process has this number, as on another machine or after the restart of
    a container.
    """
    if not path.is_file():
        return
    written_s = path.stat().st_mtime
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:  # half a file, by a kill
        content = {}
    write = {
        file: entry
        for file, entry in content.get("write", {}).items()
        if is_dvc(entry["pid"], written_s)
    }
    read = {}
    for file, entries in content.get("read", {}).items():
        alive = [entry for entry in entries if is_dvc(entry["pid"], written_s)]
        if alive:
            read[file] = alive
    write_text(path, json.dumps({"write": write, "read": read}))


def is_dvc(pid: int, since_s: float) -> bool:
    """Return whether a process is a ``dvc`` that started before the time `since_s`."""
    try:
        process = psutil.Process(pid)
        words = process.cmdline()
        return process.create_time() < since_s and "dvc" in [Path(word).name for word in words]
    # that of another user is no run here: the folder is locked
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        return False


def run_dvc(run: Path) -> None:
    """Run DVC's commands. Raises Exit with the status of the first that fails."""
    commands = [*DVC]
    if not (run / ".dvc").is_dir():
        commands.insert(0, "init --quiet --no-scm")
    # of an earlier version
    if (run / "dvc.lock").exists() and not (run / "dvc.lock.ended").exists():
        keep_lock(run, ended_well=True)
    status = 0
    groups = list[int]()
    with interrupting(groups) as interrupted:
        for words in commands:
            # A group of its own: `timeout` and a closed terminal signal all processes of the group
            # of make.
            process = subprocess.Popen(
                ["dvc", *words.split()], cwd=run, process_group=0, stdin=subprocess.DEVNULL
            )
            groups.append(process.pid)
            if interrupted:  # before the process was known
                os.killpg(process.pid, signal.SIGINT)
            status = process.wait() or len(interrupted)
            if status:
                break
    keep_lock(run, ended_well=not status)
    if status:
        raise typer.Exit(status)


@contextmanager
def interrupting(groups: list[int]) -> Iterator[list[int]]:
    """Pass signals that end this process on to the last group of processes, as Ctrl-C; yield the
    list of signals.

    DVC and stages end by themselves. Killed, DVC would leave locks, and a stage would go on without
    it.
    """
    interrupted = list[int]()

    def interrupt(number: int, _: object) -> None:
        interrupted.append(number)
        with suppress(ProcessLookupError):
            if groups:
                os.killpg(groups[-1], signal.SIGINT)

    handlers = {}
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:
            handlers[number] = signal.signal(number, interrupt)
        # as in the background of a script: DVC would inherit that, and not end
        elif number == signal.SIGINT:
            handlers[number] = signal.signal(number, lambda *_: None)
    try:
        yield interrupted
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def keep_lock(run: Path, *, ended_well: bool) -> None:
    """Keep dvc.lock, which names results, of the last run that ended well before the current
    results.

    It is dvc.lock.before; dvc.lock.ended is of the last run that ended well, whether or not results
    differ.
    """
    lock = run / "dvc.lock"
    ended = run / "dvc.lock.ended"
    if not lock.exists():
        return
    if ended.exists() and ended.read_bytes() != lock.read_bytes():
        write_text(run / "dvc.lock.before", ended.read_text(encoding="utf-8"))
    if ended_well:
        write_text(ended, lock.read_text(encoding="utf-8"))


def next_command(name: str, run: Path, settings: dict[str, Any]) -> str:
    """Return the command after a run: a prediction with the lens of a recording, or the next
    run.
    """
    ingest = settings["ingest"]
    recordings = ingest.get("recordings", {})
    for drive in ingest["drives"]["test"]:
        if drive not in recordings:
            continue
        part = recordings[drive]
        lens = [
            f"--{key} {part[key]}" for key in ("fov", "K", "distortion", "fisheye") if key in part
        ]
        return " ".join(
            [
                "steer predict VIDEO",
                *lens,
                f"--model {run}/data/train/{next(iter(settings['models']))}",
            ]
        )
    return f"$EDITOR presets/{name}.yaml && make {name}  # trains only what changed"


def changes(new: dict[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Return what differs in nested settings, as a preset: None for a key that `new` lacks."""
    both = {
        key: (new.get(key), old.get(key)) for key in {**old, **new} if new.get(key) != old.get(key)
    }
    return {
        key: changes(a, b) if isinstance(a, dict) and isinstance(b, dict) else a
        for key, (a, b) in both.items()
    }


if __name__ == "__main__":
    console.run(main)
