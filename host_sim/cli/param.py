"""``omnibot param``: what a robot may be told at run time, read and changed over the bus."""

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from host_sim.bus_choice import BusChoice, choose_bus
from host_sim.cli import completion
from host_sim.cli.app import app, parse_settings
from host_sim.cli.bus import (
    BitrateOption,
    BusOption,
    ChannelOption,
    DbcOption,
    InterfaceOption,
    NodeOption,
    TimeoutOption,
    check_timeout,
)
from host_sim.cli.text import columns
from host_sim.codec import DBC_FILE, Codec
from host_sim.errors import OmnibotError
from host_sim.link import Link, open_bus
from host_sim.parameter_file import read_values, write_values
from host_sim.parameters import ORIGINS, Change, Held, Session, plain
from host_sim.robot import load_robot

param = typer.Typer(no_args_is_help=True, help="Read and change the parameters of a robot over its bus.")
app.add_typer(param, name="param")

AsJson = Annotated[bool, typer.Option("--json", help="print JSON instead of the table")]


@contextlib.contextmanager
def _session(
    bus: str,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    node: int,
    timeout: float,
    dbc: Path,
    *,
    changes: bool = False,
) -> Iterator[Session]:
    check_timeout(timeout)
    if changes:
        _refuse_short_lived(choose_bus(bus, interface, channel, bitrate))
    with open_bus(bus, node, interface, channel, bitrate) as opened:
        yield Session(Link(opened, Codec(dbc, node), timeout), load_robot())


def _refuse_short_lived(choice: BusChoice) -> None:
    """Refuse to change what is gone when the command ends."""
    if choice.interface == "omnibot" or choice.label in ("inproc", "pil"):
        kind = "the emulated board" if choice.label == "pil" else "the firmware in-process"
        raise OmnibotError(
            f"{kind} lives only for this command: name the robot's bus (--bus vcan0, or -i and -c), or give parameters "
            "to a run itself: omnibot run --set NAME=VALUE or --set-file FILE"
        )


def _print(text: str) -> None:
    print(text)  # noqa: T201


def _row(held: Held) -> list[str]:
    told, value = held
    mark = "" if told.text(value) == told.text(told.default) else "*"
    kind = "choice" if told.choices else "integer" if told.integer else "real"
    span = told.range_text() if told.choices else f"{told.minimum:g} … {told.maximum:g}"
    return [str(told.index), told.name, told.text(value) + mark, told.text(told.default), told.unit, kind, span]


def _summary(session: Session) -> str:
    if session.store is None:
        return f"the robot is {session.moving} for another host: it was only listened to and asked"
    origin, unsaved = session.store
    hint = "; omnibot param save keeps them" if unsaved and origin != "NO_MEMORY" else ""
    return f"the robot came up with {ORIGINS[origin]}; {unsaved} of {len(session.held)} differ from that now{hint}"


def _document(session: Session, held: Sequence[Held]) -> dict[str, Any]:
    store = None if session.store is None else session.store._asdict()
    return {"moving": session.moving, "store": store, "parameters": [told.as_dict() for told in held]}


def _show(session: Session, held: Sequence[Held], as_json: bool) -> None:
    if as_json:
        _print(json.dumps(_document(session, held), indent=2))
        return
    heading = ["index", "name", "value", "default", "unit", "type", "range"]
    _print(columns([heading, *(_row(told) for told in held)]))


def _show_changes(session: Session, changes: Sequence[Change], as_json: bool) -> None:
    if as_json:
        _show(session, [session.named(change.parameter.name) for change in changes], as_json=True)
        return
    for told, before, after in changes:
        _print(f"{told.name}: {told.text(before)} → {told.text(after)}{_unit(told.unit)}")
    _print(_summary(session))


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


@param.command("list")
def list_all(
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    out: Annotated[Path | None, typer.Option(help="write the values into a .toml or .json file as well")] = None,
    as_json: AsJson = False,
) -> None:
    """List every parameter as the robot tells it; a value with * is not the default."""
    with _session(bus, interface, channel, bitrate, node, timeout, dbc) as session:
        if out is not None:
            write_values(out, session.held)
        _show(session, session.held, as_json)
        if not as_json:
            _print(_summary(session))


@param.command()
def get(
    names: Annotated[
        list[str], typer.Argument(help="names of parameters", metavar="NAME…", autocompletion=completion.parameter)
    ],
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Print the values in force; of one name alone, for scripts, only the value."""
    with _session(bus, interface, channel, bitrate, node, timeout, dbc) as session:
        held = [session.named(name) for name in names]
        if as_json:
            _show(session, held, as_json)
        elif len(held) == 1:
            _print(held[0].parameter.text(held[0].value))
        else:
            _print("\n".join(f"{told.name} = {told.text(value)}{_unit(told.unit)}" for told, value in held))


@param.command("set")
def set_values(
    settings: Annotated[
        list[str] | None, typer.Argument(help="NAME=VALUE …", metavar="NAME=VALUE…", autocompletion=completion.setting)
    ] = None,
    file: Annotated[Path | None, typer.Option(help="values from a .toml or .json file; those beside it win")] = None,
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Put values in force until the robot's next start, all of them or none; ``save`` keeps them."""
    wanted = ({} if file is None else read_values(file)) | parse_settings("omnibot param set", settings or [])
    if not wanted:
        raise OmnibotError("omnibot param set: give NAME=VALUE, or --file FILE")
    with _session(bus, interface, channel, bitrate, node, timeout, dbc, changes=True) as session:
        _show_changes(session, session.change(wanted), as_json)


@param.command()
def save(
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Keep what is in force over a restart, in the board's flash or the file of omnibot-sil --parameters."""
    with _session(bus, interface, channel, bitrate, node, timeout, dbc, changes=True) as session:
        session.save()
        if as_json:
            _show(session, session.held, as_json)
        else:
            _print(f"{len(session.held)} parameters are kept: the robot's next start finds them")


@param.command()
def reset(
    names: Annotated[
        list[str] | None, typer.Argument(help="names of parameters (default: all)", autocompletion=completion.parameter)
    ] = None,
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Put defaults in force; what is kept stays kept until ``save``."""
    with _session(bus, interface, channel, bitrate, node, timeout, dbc, changes=True) as session:
        changes = session.reset(names or [])
        _show_changes(session, changes if names or as_json else [c for c in changes if c.before != c.after], as_json)


@param.command()
def diff(
    file: Annotated[
        Path | None, typer.Argument(help="a .toml or .json file, result.json too (default: the defaults)")
    ] = None,
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    as_json: AsJson = False,
) -> None:
    """Tell which values in force differ from the defaults, or from a file's; exit code 1 when some do."""
    with _session(bus, interface, channel, bitrate, node, timeout, dbc) as session:
        differences = session.differences(None if file is None else read_values(file))
    other = "default" if file is None else "file"
    if as_json:
        _print(
            json.dumps(
                [
                    {"name": told.name, "value": plain(told, held), other: plain(told, theirs)}
                    for told, theirs, held in differences
                ],
                indent=2,
            )
        )
    elif differences:
        rows = [[told.name, told.text(held), told.text(theirs), told.unit] for told, theirs, held in differences]
        _print(columns([["name", "value", other if file is None else str(file), "unit"], *rows]))
    else:
        print(f"no parameter differs from {'the defaults' if file is None else file}", file=sys.stderr)  # noqa: T201
    if differences:
        raise typer.Exit(1)
