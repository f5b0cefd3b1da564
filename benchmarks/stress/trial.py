"""One trial after the other in a child process, which may hang, die or eat memory without harm."""

import multiprocessing
import os
import resource
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from pipeline.base.errors import InputError

HANG_S = 5.0  # of a core
WAIT_S = 30.0  # of the clock, as others may use the cores
MOST_BYTES = 2 << 30

SOUND = ("refused", "same", "consistent")
Work = Callable[[int], bool]
"""Does trial number n. True: what was read is that of the sound file; False: it is not, but consistent. Raises
InputError where the file is refused, AssertionError where it reads wrong."""


@dataclass(frozen=True)
class Outcome:
    """What came of a trial: refused, same, consistent; or wrong, traceback, nameless, hang, memory, crash."""

    trial: int
    kind: str
    detail: str = ""
    seconds: float = 0.0

    @property
    def sound(self) -> bool:
        return self.kind in SOUND


def outcomes(work: Work, trials: range, path: Path) -> Iterator[Outcome]:
    """Do all trials, in children one after the other; `path` is the file that a message must name."""
    todo = list(trials)
    while todo:
        ours, theirs = multiprocessing.Pipe()
        child = multiprocessing.get_context("fork").Process(target=_work, args=(work, todo, path, theirs))
        child.start()
        theirs.close()
        try:
            while todo:
                if not ours.poll(WAIT_S):
                    yield Outcome(todo.pop(0), "hang", f"more than {WAIT_S:.0f} s")
                    break
                yield ours.recv()
                todo.pop(0)
        except EOFError:
            child.join()
            yield Outcome(todo.pop(0), "crash", f"exit status {child.exitcode}")
        finally:
            child.kill()
            child.join()
            ours.close()


def _work(work: Work, trials: list[int], path: Path, results: Connection) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)  # decoders print what they think of a file
    os.dup2(silence, 1), os.dup2(silence, 2)
    warnings.simplefilter("error")  # users would see it
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MOST_BYTES, mapped + MOST_BYTES))
    for trial in trials:
        start = time.process_time()
        kind, detail = _judged(work, trial, path)
        seconds = time.process_time() - start
        results.send(Outcome(trial, "hang" if seconds > HANG_S else kind, detail, seconds))


def _judged(work: Work, trial: int, path: Path) -> tuple[str, str]:
    try:
        return ("same" if work(trial) else "consistent"), ""
    except InputError as error:
        return ("refused" if path.name in str(error) else "nameless"), str(error)
    except OSError as error:  # a line too, by pipeline.base.console
        return ("refused" if path.name in str(error) else "nameless"), str(error)
    except AssertionError:
        return "wrong", traceback.format_exc()
    except MemoryError:
        return "memory", traceback.format_exc()
    except Exception:
        return "traceback", traceback.format_exc()
