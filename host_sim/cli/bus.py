"""The options that name a bus and a robot on it, the same for every verb that speaks to one."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import can
import typer

from host_sim.cli import completion
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.link import FrameRecord, Link
from host_sim.pil import EmulatedBoard

BusOption = Annotated[
    str,
    typer.Option(
        envvar="OMNIBOT_BUS",
        help="inproc, pil (the board's image, emulated), a SocketCAN interface, or can (python-can's configuration)",
        autocompletion=completion.bus,
    ),
]
InterfaceOption = Annotated[
    str | None,
    typer.Option("-i", "--interface", help="python-can interface, over --bus", autocompletion=completion.interface),
]
ChannelOption = Annotated[
    str | None,
    typer.Option(
        "-c",
        "--channel",
        help="python-can channel; with --bus pil the image, if not build/board's",
        autocompletion=completion.channel,
    ),
]
BitrateOption = Annotated[int | None, typer.Option("-b", "--bitrate", help="bit/s, where the interface wants it")]
NodeOption = Annotated[int, typer.Option(help="the robot's node on the bus, 0 to 15", autocompletion=completion.node)]
TimeoutOption = Annotated[float, typer.Option(help="wall-clock seconds the firmware may be silent")]
DbcOption = Annotated[Path, typer.Option(help="wire definition to speak")]


def check_timeout(timeout: float) -> None:
    """Refuse a time that makes no sense."""
    if not 1e-3 <= timeout <= 3600.0:
        raise OmnibotError(f"--timeout {timeout:g} must be 0.001 … 3600 s")


def link_on(bus: can.BusABC, codec: Codec, timeout: float, record: Callable[[FrameRecord], None]) -> Link:
    """Return a session on a bus, its frames recorded."""
    # An emulator loses nothing: asking again where a machine is slow would only fill the log.
    return Link(bus, codec, timeout, record, timeout if isinstance(bus, EmulatedBoard) else None)
