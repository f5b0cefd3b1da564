"""Scratch copies of the project, and DVC run in them as a user runs it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from pipeline.base import resume


def copy(folder: Path) -> Path:
    """Copy the repository as git sees it, with edits that are not committed, into a repository of its own."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=resume.ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    for name in listed:
        if (resume.ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(resume.ROOT / name, folder / name)
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    commit(folder, "scratch")
    return folder


def commit(folder: Path, message: str) -> None:
    """Commit all that git sees of a scratch copy."""
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)
    who = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    subprocess.run(["git", *who, "commit", "-qm", message], cwd=folder, check=True)


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Return the variables for commands of this environment that run the code of a folder."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "DVC_NO_ANALYTICS": "1", "PYTHONPATH": str(folder), **more}


def run(folder: Path, *command: str, check: bool = True) -> str:
    """Run a command in a scratch copy, on its own code; return what it printed. With `check` off it must fail."""
    done = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    assert not check or done.returncode == 0, output
    assert check or done.returncode != 0, output
    return output


def stages_run(output: str) -> list[str]:
    """The stages that DVC ran, without those that it took from its cache."""
    return [line.split("'")[1] for line in output.splitlines() if line.startswith("Running stage")]


def files_of(folder: Path, stages: list[str]) -> dict[str, bytes]:
    """Return relative path → contents of what stages have written."""
    paths = [path for stage in stages for path in (folder / "data" / stage).rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def edit_params(folder: Path, **sections: Any) -> None:
    """Replace whole sections of a scratch copy's params.yaml."""
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **sections}, sort_keys=False))


def settle(folder: Path) -> None:
    """Have DVC take what is there for what the stages made; outs that are not there become folders with one file."""
    stages = yaml.safe_load((folder / "dvc.yaml").read_text())["stages"]
    params = yaml.safe_load((folder / "params.yaml").read_text())
    for stage in stages.values():
        for key in params[stage["foreach"][2:-1]] if "foreach" in stage else [""]:
            for out in stage.get("do", stage).get("outs", []):
                path = folder / (next(iter(out)) if isinstance(out, dict) else out).replace("${key}", key)
                if not path.exists():
                    placeholder = path if path.suffix else path / "placeholder"
                    placeholder.parent.mkdir(parents=True, exist_ok=True)
                    placeholder.write_text("")
    run(folder, "dvc", "commit", "--force")
    assert changed(folder) == set()


def changed(folder: Path) -> set[str]:
    """Return the stages that `dvc status` says would run for what changed in their own deps and params."""
    return set(json.loads(run(folder, "dvc", "status", "--json")))
