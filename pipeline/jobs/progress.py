"""Print the progress within an epoch: a bar, or a line after five seconds."""

import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from threading import Timer
from typing import TypeVar

from tqdm import tqdm

# Time in seconds between the first step of a training and its line.
LINE_AFTER_S = 5.0
# Text of a bar. Its end returns to the start of the line, so that a line of another process, which
# is longer, replaces the bar.
_BAR = "{desc}: {percentage:3.0f} %|{bar:10}| {n_fmt} of {total_fmt} steps, {remaining} left\r"
B = TypeVar("B")


@dataclass
class Progress:
    """Prints the progress of the training of a network, which may run in another process."""

    title: str
    epochs: int
    # Whether a terminal shows a bar. Bars of several processes would overwrite each other.
    has_bar: bool
    # Whether an epoch has begun.
    has_begun: bool = False

    def watch_steps(self, batches: Iterable[B], epoch: int, steps: int) -> Iterator[B]:
        """Yield the batches of an epoch, one for each of its steps, and print the progress.

        Each epoch has a bar. Without a bar, the first epoch prints a line after five seconds, and
        another one after the first step if that takes longer.
        """
        title = f"{self.title}: epoch {epoch} of {self.epochs}"
        if self.has_bar and sys.stderr.isatty():
            yield from tqdm(batches, title, steps, leave=False, bar_format=_BAR)
            return
        if self.has_begun:
            yield from batches
            return

        self.has_begun = True
        done = 0
        started_s = time.perf_counter()

        def print_line() -> None:
            seconds = time.perf_counter() - started_s
            text = f"{title}, {done} of {steps} steps in {seconds:.0f} s"
            if done:
                left = (self.epochs - epoch + 1) * steps - done
                text += f", ETA {seconds / done * left:.0f} s"
            print(text, flush=True)

        timer = Timer(LINE_AFTER_S, print_line)
        timer.daemon = True
        timer.start()
        try:
            for batch in batches:
                yield batch
                done += 1
                if done == 1 and not timer.is_alive():
                    print_line()
        finally:
            timer.cancel()
