"""Keys of ARM over a real vcan: the same in lockstep after each start, and unforeseeable by the clock."""

import subprocess
from collections.abc import Callable

from host_sim.codec import Codec
from host_sim.link import Link, open_bus
from host_sim.planner import PathRequest, plan

Start = Callable[..., "subprocess.Popen[bytes]"]


def key_of(start_firmware: Start, time: str) -> int:
    """The key that a firmware just started gives for ARM."""
    firmware = start_firmware("--time", time)
    with open_bus("vcan0", node=0, interface=None, channel=None, bitrate=None) as bus:
        link = Link(bus, Codec())
        link.hello(time)
        link.upload(plan(PathRequest("line", 0.2)).to_bytes())
        link.command("ARM")
        assert link._key is not None
    firmware.kill()
    firmware.wait()
    return link._key


def test_keys_are_the_same_in_lockstep_and_others_by_the_clock(start_firmware: Start) -> None:
    assert key_of(start_firmware, "lockstep") == key_of(start_firmware, "lockstep")
    assert key_of(start_firmware, "realtime") != key_of(start_firmware, "realtime")
