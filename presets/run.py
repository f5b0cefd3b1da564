"""``make NAME``: run a preset in runs/NAME, a copy of the code with its own DVC cache."""

import json
import shutil
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import typer

from pipeline.base import console
from pipeline.base.checkout import CHECKOUT, CODE, revision
from pipeline.base.errors import InputError
from pipeline.base.outputs import locked
from pipeline.base.params import parse, read_yaml
from pipeline.base.store import write_json, write_text
from pipeline.check import preset
from pipeline.encoder.settings import Encoder
from pipeline.encoder.weights import weights_hash
from pipeline.report.origin import RUN, duration, origin, read_run

# Commands of DVC that a run executes. Hard links to the run's own cache save space on the disk.
DVC = ("config cache.type hardlink,copy", "cache dir .dvc/cache", "repro")


def main(name: str) -> None:
    """Run preset `name` and copy its report to data/report/NAME.*.

    Raises InputError if the preset is running already.
    """
    run = Path("runs") / name

    # All settings are checked before anything is written.
    preset.check_name_is_free(name)
    params = Path("params.yaml")
    settings = preset.merged(name, params)
    take_weights(settings["encoder"], run / "params.yaml")

    run.parent.mkdir(exist_ok=True)
    with locked(run, f"{run}.lock"):
        check_is_run(run)
        record = {
            "preset": name,
            "revision": revision(),
            "started_s": time.time(),
            "settings": changes(settings, read_yaml(params)),
            "next": next_command(name, run, settings),
        }
        write_json(run / RUN, record, sort_keys=False)
        write_text(run / CHECKOUT, str(Path.cwd()))
        preset.write(settings, run / "params.yaml", f"make {name}")
        copy_code(run)
        run_dvc(run)
        publish(run, Path("data/report"), name)
    print(f"next: {record['next']}", f"Open data/report/{name}.html in a browser.", sep="\n")


def publish(run: Path, report: Path, name: str) -> None:
    """Copy the page, the table and the results of a run to files NAME.*, and print the table."""
    results = json.loads((run / "data/report/results.json").read_text(encoding="utf-8"))
    run_origin = origin(run)
    write_json(report / f"{name}.json", run_origin | {"results": results}, sort_keys=False)
    for source, suffix in {"index.html": "html", "table.md": "md"}.items():
        text = (run / "data/report" / source).read_text(encoding="utf-8")
        write_text(report / f"{name}.{suffix}", text)
    facts = [f"{key} {value}" for key, value in run_origin.items()]
    facts.append(f"{duration(read_run(run))} of the last make")
    print(text, ", ".join(facts), sep="\n")


def check_is_run(run: Path) -> None:
    """Raise InputError if a folder has files, but no earlier run made it."""
    if run.exists() and any(run.iterdir()) and not (run / RUN).exists():
        raise InputError("is a folder that no run made", run, "Move it away, or rename the preset")


def take_weights(encoder: dict[str, Any], params: Path) -> None:
    """Add the hash of the weights to section `encoder`, so that DVC notices another file.

    If the file is missing, the hash in the run's `params` stays: results of an earlier run can be
    used without the weights.
    """
    earlier = read_yaml(params).get("encoder", {}) if params.is_file() else {}
    same_file = earlier.get("weights") == encoder.get("weights")
    if same_file and "weights_sha256" in earlier and not Path(encoder["weights"]).exists():
        encoder["weights_sha256"] = earlier["weights_sha256"]
        return
    weights_sha256 = weights_hash(parse(Encoder, encoder, "encoder"))
    if weights_sha256:
        encoder["weights_sha256"] = weights_sha256


def copy_code(run: Path) -> None:
    """Copy the code to the folder of a run, and remove files that the code no longer has.

    copied.json lists the copied files. Only files that an earlier list has are removed.
    """
    listed = run / "copied.json"
    before = set[str]()
    if listed.exists():
        before.update(json.loads(listed.read_text(encoding="utf-8")))
    paths = list[Path]()
    for name in CODE:
        paths += [Path(name), *Path(name).rglob("*.*")]
    now = {str(path) for path in paths if path.is_file() and path.suffix != ".pyc"}
    for name in before - now:
        (run / name).unlink(missing_ok=True)
    for name in now:
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(name, run / name)
    write_json(listed, sorted(now))


def run_dvc(run: Path) -> None:
    """Run the commands of DVC. Raises Exit with the status of the first command that fails."""
    commands = [*DVC]
    if not (run / ".dvc").is_dir():
        commands.insert(0, "init --quiet --no-scm")
    for words in commands:
        process = subprocess.Popen(["dvc", *words.split()], cwd=run)
        while process.poll() is None:
            # Ctrl-C reaches DVC, too, which ends its stage and then itself.
            with suppress(KeyboardInterrupt):
                process.wait()
        if process.returncode:
            raise typer.Exit(1)


def next_command(name: str, run: Path, settings: dict[str, Any]) -> str:
    """Return the command that a user may run next.

    If a test drive is part of a recording, it is a prediction for a video with the same lens, else
    another run of the preset.
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
        model = next(iter(settings["models"]))
        words = ["steer predict VIDEO", *lens, f"--model {run}/data/train/{model}"]
        return " ".join(words)
    return f"$EDITOR presets/{name}.yaml && make {name}  # trains only what changed"


def changes(new: dict[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Return the preset that turns settings `old` into `new`. A key that `new` lacks is None."""
    preset_changes = dict[str, Any]()
    for key in {**old, **new}:
        value = new.get(key)
        old_value = old.get(key)
        if value == old_value:
            continue
        if isinstance(value, dict) and isinstance(old_value, dict):
            value = changes(value, old_value)
        preset_changes[key] = value
    return preset_changes


if __name__ == "__main__":
    console.run(main)
