"""Verbs for what was on a bus: ``log record``, ``log export`` and ``replay``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from host_sim.canlog import SUFFIXES, Recording, record, whole_file, write_log
from host_sim.cli.app import RunFailedError, app
from host_sim.cli.bus import BitrateOption, BusOption, ChannelOption, InterfaceOption, TimeoutOption, check_timeout
from host_sim.codec import DBC_FILE
from host_sim.errors import OmnibotError
from host_sim.link import open_bus
from host_sim.mcap_file import write_mcap
from host_sim.monitor.listen import choose_listening, open_listening
from host_sim.replay import Outcome, inspect, replay
from host_sim.signals import RunSignals, open_signals, write_csv, write_npz

SIGNAL_WRITERS: dict[str, Callable[[RunSignals, Path], None]] = {
    "csv": write_csv,
    "npz": write_npz,
    "mcap": write_mcap,
}
FORMATS = (*SIGNAL_WRITERS, *(suffix.removeprefix(".") for suffix in SUFFIXES))

log = typer.Typer(no_args_is_help=True, help="Record what is on a bus, and give a log in other formats.")
app.add_typer(log, name="log")

Node = Annotated[int | None, typer.Option(min=0, max=15, help="the robot's node (default: the only one in the log)")]
Dbc = Annotated[Path, typer.Option(help="wire definition to read it by")]
AsJson = Annotated[bool, typer.Option("--json", help="print the result as JSON")]


@log.command("record")
def record_log(
    file: Annotated[Path, typer.Argument(help="a new file; its suffix tells the format: .log, .asc or .blf")],
    bus: BusOption = "vcan0",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="time to record, s (default: until Ctrl-C)")] = None,
    as_json: AsJson = False,
) -> None:
    """Record every frame on a bus, with the time at which it came."""
    with open_listening(choose_listening(bus, interface, channel, bitrate), 0) as opened:
        frames = record(opened, file, duration)
    print(json.dumps({"file": str(file), "frames": frames}) if as_json else f"{frames} frames: {file}")  # noqa: T201


@log.command("export")
def export_log(
    source: Annotated[Path, typer.Argument(help="a bus log, or the folder of a run: then with what the plant did")],
    out: Annotated[Path, typer.Option(help="file to write")],
    to: Annotated[str | None, typer.Option(help=f"{', '.join(FORMATS)} (default: what --out ends in)")] = None,
    node: Node = None,
    dbc: Dbc = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Give a log as signals (csv, npz, or mcap for Foxglove and PlotJuggler), or as another bus log."""
    kind = to or out.suffix.removeprefix(".").lower()
    if kind not in FORMATS:
        raise OmnibotError(f"no format {kind!r}: --to {', '.join(FORMATS)}, or a file --out that ends in one of them")
    recording = Recording(source)
    if out.exists() and out.samefile(recording.path):
        raise OmnibotError(f"{out} is the log itself: choose another file with --out")
    damaged = 0
    if kind in SIGNAL_WRITERS:
        signals = open_signals(source, node, dbc)
        with whole_file(out) as temporary:
            SIGNAL_WRITERS[kind](signals, temporary)
        damaged = signals.wire.damaged
    else:
        write_log(recording, out, f".{kind}")
    note = f"; {damaged} damaged frames left out" if damaged else ""
    print(json.dumps({"file": str(out), "damaged": damaged}) if as_json else f"{out}{note}")  # noqa: T201


@app.command("replay")
def replay_log(
    source: Annotated[Path, typer.Argument(help="a bus log of a lockstep session, or the folder of a run")],
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: Node = None,
    timeout: TimeoutOption = 2.0,
    dbc: Dbc = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Send a log's frames to the firmware once more; it must give the recorded answers, byte for byte."""
    check_timeout(timeout)
    session = inspect(source, node, dbc)
    with open_bus(bus, session.codec.node, interface, channel, bitrate) as opened:
        outcome = replay(session, opened, timeout)
    print(json.dumps(outcome.as_dict(), indent=2) if as_json else told(outcome))  # noqa: T201
    if outcome.gave_up:
        raise RunFailedError(outcome.gave_up)
    if outcome.differences:
        raise RunFailedError(f"{session.recording.path} was not replayed the same; first, {outcome.differences[0]}")


def told(outcome: Outcome) -> str:
    """Return an outcome in a few lines."""
    lines = [str(item) for item in outcome.differences]
    if outcome.excused:
        names = ", ".join(item.name for item in outcome.excused)
        lines.append(f"of what the robot did before the session, and no part of it: {names}")
    verdict = f"different: {len(outcome.differences)} signals" if outcome.differences else "identical"
    extent = f"{outcome.frames} frames of the robot in {outcome.ticks} ticks"
    return "\n".join([*lines, f"{verdict}; compared {extent}, byte for byte"])
