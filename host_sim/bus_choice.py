"""Which bus the command line names, with python-can's own configuration where that is asked for."""

import configparser
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import can
from can.interfaces import VALID_INTERFACES

from host_sim.errors import OmnibotError

CONFIGURED = "can"  # --bus: what python-can's configuration says
SOURCES = "CAN_INTERFACE and CAN_CHANNEL, CAN_CONFIG, or interface = … and channel = … below [default] in ~/.canrc"


@dataclass(frozen=True)
class BusChoice:
    """A bus: one of our names, or python-can's interface with its options.

    Attributes
    ----------
    name
        ``inproc``, ``pil`` or a SocketCAN interface; what it says counts only where ``interface`` is None.
    interface, channel, bitrate, others
        python-can's, its configuration included. With ``pil``, the channel is the image to run.
    """

    name: str
    interface: str | None = None
    channel: str | int | None = None
    bitrate: int | None = None
    others: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return a name for people and for results."""
        return self.name if self.interface is None else f"{self.interface}:{self.channel}"


def choose_bus(name: str, interface: str | None, channel: str | None, bitrate: int | None) -> BusChoice:
    """Return the bus that the options name: see ``BusChoice``.

    Our own buses never depend on python-can's configuration. ``can`` does, and so does an interface, a channel or a bit
    rate without the others: what is missing is looked up as in python-can's own tools.
    """
    if interface is None and name == "pil" and bitrate is None:
        return BusChoice(name, channel=channel)
    if interface is None and channel is None and bitrate is None and name != CONFIGURED:
        return BusChoice(name)
    if interface is None and name not in (CONFIGURED, "inproc"):
        option = f"--channel {channel}" if channel is not None else f"--bitrate {bitrate}"
        raise OmnibotError(f"{option} says nothing beside --bus {name}: name python-can's bus with -i, -c and -b")
    found = _configured({"interface": interface, "channel": channel, "bitrate": bitrate})
    return BusChoice(name, found.pop("interface"), found.pop("channel", None), found.pop("bitrate", None), found)


def _configured(given: Mapping[str, str | int | None]) -> dict[str, Any]:
    """Return the options of a bus: what is given, then python-can's environment, then its files."""
    try:
        return dict(can.util.load_config(config={key: value for key, value in given.items() if value is not None}))
    except can.CanInterfaceNotImplementedError as error:
        known = f"there are: {', '.join(sorted(VALID_INTERFACES))}"
        if given["interface"] is None and '"None"' in str(error):
            raise OmnibotError(f"no CAN interface is configured: give one with -i, or {SOURCES}") from error
        raise OmnibotError(f"cannot open the bus: {error}; {known}") from error
    except (ValueError, TypeError, OSError, configparser.Error) as error:
        reason = " ".join(str(error).split())
        raise OmnibotError(f"cannot read python-can's configuration ({SOURCES}): {reason}") from error
