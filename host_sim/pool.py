"""Many independent runs on all cores, that Ctrl-C ends without a loss."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Case = TypeVar("Case")
Row = TypeVar("Row")


def _leave_ctrl_c_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def in_processes(
    run: Callable[[Case], Row], cases: Iterable[Case], jobs: int | None = None, at_once: int = 1
) -> Iterator[Row]:
    """Run cases on so many processes (default: one a core), some at once on each; gives their rows in order.

    Closed early, by Ctrl-C for one, it waits for the cases that are running and begins no others.
    """
    with ProcessPoolExecutor(jobs or os.cpu_count(), initializer=_leave_ctrl_c_to_the_parent) as pool:
        yield from pool.map(run, cases, chunksize=at_once)
