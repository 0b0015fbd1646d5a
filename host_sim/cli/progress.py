"""How far long work is, and how long it will take: on stderr, and only on a terminal."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from rich.console import Console, RenderableType
from rich.progress import Progress, track

from host_sim.cli.app import CutShortError

Row = TypeVar("Row")


class _Watch(Progress):
    """Looks by itself how far the work is, ten times a second: the work need not stop to tell it."""

    def __init__(self, now: Callable[[], float], console: Console) -> None:
        self._now = now
        super().__init__(console=console, transient=True, disable=not console.is_terminal)

    def get_renderables(self) -> Iterable[RenderableType]:
        for task in self.tasks:
            self.update(task.id, completed=self._now())
        yield from super().get_renderables()


@contextlib.contextmanager
def watched(what: str, total: float, now: Callable[[], float]) -> Iterator[None]:
    """Show how far the work of the block is: ``now`` of ``total``."""
    with _Watch(now, Console(stderr=True)) as watch:
        watch.add_task(what, total=total)
        yield


def until_ctrl_c(rows: Iterable[Row], total: int, what: str) -> Iterator[Row]:
    """Give rows, and show how many of them there are, until the last one or Ctrl-C."""
    console = Console(stderr=True)
    with contextlib.suppress(KeyboardInterrupt):
        yield from track(rows, what, total, console=console, transient=True, disable=not console.is_terminal)


def refuse_cut_short(count: int, total: int, what: str) -> None:
    """Say of a table that was written and printed that Ctrl-C came before its last row."""
    if count < total:
        raise CutShortError(f"interrupted: {what} has {count} of {total} rows")
