"""The monitor in a terminal, by rich: a picture that is drawn anew, or lines where the output is a pipe."""

import contextlib
import math
import re
from collections.abc import Callable, Sequence
from time import localtime, monotonic, sleep, strftime

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from host_sim.monitor.driving import Sample
from host_sim.monitor.listen import Listener, News
from host_sim.monitor.state import Event
from host_sim.monitor.text import Mood, line, notice, rows

FRAMES_PER_S = 8.0
NAME_COLUMNS = 11
EVENT_LINES = 6
BLOCKS = " ▁▂▃▄▅▆▇█"
ASCII_BLOCKS = " .:-=+*#@"
CURVES: tuple[tuple[str, str, Callable[[Sample], float]], ...] = (
    ("error", "mm", lambda sample: 1e3 * sample.error_m),
    ("speed", "m/s", lambda sample: sample.speed_m_per_s),
    ("slip", "", lambda sample: max(map(abs, sample.slip_ratio))),
    ("torque", "N*m", lambda sample: max(map(abs, sample.torque_Nm))),
)


def sparkline(values: Sequence[float], columns: int, blocks: str = BLOCKS) -> str:
    """Return values as bars of a character's height, from 0 to the largest; a gap is what is not known.

    Where there are more values than columns, a column shows the largest of its share.
    """
    share = max(math.ceil(len(values) / columns), 1)
    parts = [
        [value for value in values[begin : begin + share] if math.isfinite(value)]
        for begin in range(0, len(values), share)
    ]
    largest = max((max(part) for part in parts if part), default=0.0)
    steps = len(blocks) - 1
    return "".join(
        blocks[max(1, math.ceil(steps * max(part) / largest)) if largest > 0.0 else 1] if part else " "
        for part in parts
    )


def picture(news: News, columns: int, lines: int, *, ascii_only: bool = False) -> RenderableType:
    """Return the screen: what is known, curves of the last half minute, what happened last."""
    table = Table.grid(padding=(0, 1))
    table.add_column(width=NAME_COLUMNS, style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    known = rows(news.snapshot)
    for row in known:
        style = row.mood.value if row.mood is not Mood.PLAIN else None
        table.add_row(row.name, Text(row.text, style=style or ""))
    parts: list[RenderableType] = [Text(f"omnibot monitor, node {news.snapshot.node}   Ctrl-C ends it", style="bold")]
    parts += [table, Text()]
    room = lines - len(known) - 3
    if news.samples and room >= len(CURVES):
        parts.append(_curves(news.samples, columns, ASCII_BLOCKS if ascii_only else BLOCKS))
        room -= len(CURVES) + 1
    newest = news.events[-max(min(room, EVENT_LINES), 0) :] if room > 0 else []
    parts += [Text(), *(Text(_event(event), style="dim", no_wrap=True, overflow="ellipsis") for event in newest)]
    return Group(*parts)


def _curves(samples: Sequence[Sample], columns: int, blocks: str) -> RenderableType:
    table = Table.grid(padding=(0, 1))
    table.add_column(width=NAME_COLUMNS, style="dim", no_wrap=True)
    table.add_column(no_wrap=True)
    for name, unit, value_of in CURVES:
        values = [value_of(sample) for sample in samples]
        largest = max((value for value in values if math.isfinite(value)), default=math.nan)
        bars = sparkline(values, max(columns - NAME_COLUMNS - 18, 10), blocks)
        table.add_row(name, Text(f"{bars} {'' if math.isnan(largest) else f'0 to {largest:.3g} {unit}'}"))
    return table


def _event(event: Event) -> str:
    when = "" if math.isnan(event.time_s) else f"{_clock(event.time_s)}  "
    return f"{when}{event.text}"


def _clock(time_s: float) -> str:
    """Return the time of day, where a bus' clock is that of the day; seconds elsewhere."""
    if time_s > 1e9:
        return strftime("%H:%M:%S", localtime(time_s)) + f".{int(time_s * 1e3) % 1000:03d}"
    return f"{time_s:.3f} s"


def watch(listener: Listener, console: Console, every_s: float) -> None:
    """Show the robot until Ctrl-C: on a screen, or in a line every so often and one for each event in a pipe."""
    if console.is_terminal and not console.is_dumb_terminal:
        _watch_on_screen(listener, console)
    else:
        with contextlib.suppress(KeyboardInterrupt):
            watch_in_lines(listener, console, every_s)


def _watch_on_screen(listener: Listener, console: Console) -> None:
    live = Live(console=console, screen=True, auto_refresh=False)
    with contextlib.suppress(KeyboardInterrupt), live:
        while True:
            news, (columns, lines) = listener.news(), console.size
            live.update(picture(news, columns, lines, ascii_only=console.options.ascii_only), refresh=True)
            sleep(1.0 / FRAMES_PER_S)
    for row in rows(listener.snapshot()):
        console.print(Text(f"{row.name:<{NAME_COLUMNS}}{row.text}"), soft_wrap=True)


def watch_in_lines(listener: Listener, console: Console, every_s: float, *, states: bool = True) -> None:
    """Print a line for each event, and, if ``states``, one every so often; a notice is said when it changes."""
    events, said, due_s = 0, "", monotonic()
    while True:
        news = listener.news(after_sample=1 << 62, after_event=events)
        events = news.event_count
        for event in news.events:
            console.print(Text(_event(event)), soft_wrap=True)
        now_s = monotonic()
        if states and now_s >= due_s:
            console.print(Text(line(news.snapshot)), soft_wrap=True)
            due_s = now_s + every_s
        elif not states:
            said = _say(console, said, notice(news.snapshot))
        sleep(min(every_s, 0.2))


def _say(console: Console, before: str, now: str) -> str:
    """Print a notice when its words change; its numbers may."""
    if now and re.sub(r"\d+", "", now) != re.sub(r"\d+", "", before):
        console.print(Text(now), soft_wrap=True)
    return now
