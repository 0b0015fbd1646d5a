"""The verb that looks at a robot while it drives."""

from typing import Annotated

import typer

from host_sim.cli.app import RunFailedError, app
from host_sim.cli.bus import BusOption, ChannelOption, DbcOption, InterfaceOption, NodeOption
from host_sim.codec import DBC_FILE
from host_sim.errors import OmnibotError
from host_sim.monitor.command import look_once, make_listener, serve, show
from host_sim.monitor.listen import choose_listening, open_listening
from host_sim.monitor.server import DEFAULT_PORT


@app.command()
def monitor(
    port: Annotated[
        int | None, typer.Argument(min=0, max=65535, help=f"of --serve (default: {DEFAULT_PORT}; 0: any that is free)")
    ] = None,
    bus: BusOption = "vcan0",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: Annotated[
        int | None, typer.Option("-b", "--bitrate", min=10_000, help="bit/s of the bus (default: 1000000)")
    ] = None,
    node: NodeOption = 0,
    as_page: Annotated[
        bool, typer.Option("--serve", help="a web page for this machine, on PORT of 127.0.0.1, instead of the terminal")
    ] = False,
    once: Annotated[bool, typer.Option("--once", help="print what is known after --for seconds, and end")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="the same as JSON")] = False,
    look: Annotated[float, typer.Option("--for", min=0.1, help="seconds to listen with --once and --json")] = 1.5,
    every: Annotated[float, typer.Option(min=0.05, help="seconds from line to line where the output is a pipe")] = 1.0,
    dbc: DbcOption = DBC_FILE,
) -> None:
    """Show a running robot or simulation live, by what goes over its bus; sends nothing. Ctrl-C ends it."""
    if port is not None and not as_page:
        raise OmnibotError(f"{port} is the port of --serve: omnibot monitor --serve {port}")
    if as_page and (once or as_json):
        raise OmnibotError("--serve goes on, --once and --json end: give one of them")
    choice = choose_listening(bus, interface, channel, bitrate)
    with make_listener(lambda: open_listening(choice, node), node, bitrate or choice.bitrate, dbc) as listener:
        if once or as_json:
            text, silent = look_once(listener, look, as_json=as_json)
            print(text)  # noqa: T201
            if silent:
                raise RunFailedError(silent)
        elif as_page:
            serve(listener, node, DEFAULT_PORT if port is None else port)
        else:
            show(listener, every)
