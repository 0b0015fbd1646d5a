"""What ``omnibot monitor`` does with its arguments."""

import contextlib
import json
import time
from collections.abc import Callable
from pathlib import Path

import can
from rich.console import Console

from host_sim.codec import Codec
from host_sim.monitor.listen import Listener
from host_sim.monitor.server import MonitorServer, finite
from host_sim.monitor.state import MonitorState
from host_sim.monitor.terminal import watch, watch_in_lines
from host_sim.monitor.text import SILENT_S, notice, page
from host_sim.robot import load_robot

BIT_RATE = 1_000_000  # of the wire's definition


def make_listener(open_it: Callable[[], can.BusABC], node: int, bitrate: int | None, dbc: Path) -> Listener:
    """Return a listener to one node of a bus."""
    return Listener(MonitorState(Codec(dbc, node), load_robot(), bitrate or BIT_RATE), open_it)


def look_once(listener: Listener, look_s: float, *, as_json: bool) -> tuple[str, str]:
    """Listen for a while; returns what there was to see, and why it was nothing of the robot, if so."""
    time.sleep(look_s)
    news = listener.news(after_sample=1 << 62)
    snapshot = news.snapshot
    heard_s = snapshot.bus.robot_silent_s
    silent = notice(snapshot) if heard_s is None or heard_s > max(look_s, SILENT_S) else ""
    if not as_json:
        return page(snapshot), silent
    events = [{"time_s": finite(event.time_s), "text": event.text} for event in news.events]
    return json.dumps({**snapshot.as_dict(), "notice": notice(snapshot), "events": events}, indent=2), silent


def show(listener: Listener, every_s: float) -> None:
    """Show the robot in the terminal until Ctrl-C."""
    watch(listener, Console(highlight=False), every_s)


def serve(listener: Listener, node: int, port: int) -> None:
    """Serve the page until Ctrl-C, and say what happens meanwhile."""
    console = Console(highlight=False)
    with MonitorServer(listener, load_robot(), node, port) as server:
        console.print(f"monitor: {server.url} (Ctrl-C ends it)", soft_wrap=True)
        with contextlib.suppress(KeyboardInterrupt):
            watch_in_lines(listener, console, 1.0, states=False)
