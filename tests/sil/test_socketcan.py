"""The simulator's SocketCAN bus on a real vcan."""

import errno

import can
import pytest

from host_sim.link import open_bus
from host_sim.socketcan import PromptSocketcanBus


def test_prompt_bus_sends_what_another_socket_receives() -> None:
    sent = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01\x02\x03")
    with open_bus("vcan0", 3, None, None, None) as bus, can.Bus(interface="socketcan", channel="vcan0") as other:
        assert isinstance(bus, PromptSocketcanBus)

        bus.send(sent, timeout=1.0)
        received = other.recv(1.0)

    assert received is not None
    assert (received.arbitration_id, bytes(received.data)) == (0x123, b"\x01\x02\x03")


def test_prompt_bus_without_room_waits_as_python_can_does(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float | None] = []
    monkeypatch.setattr(
        can.interfaces.socketcan.SocketcanBus, "send", lambda _bus, _msg, timeout: waited.append(timeout)
    )

    class FullSocket:
        def send(self, _data: bytes) -> int:
            raise OSError(errno.ENOBUFS, "No buffer space available")

    with open_bus("vcan0", 3, None, None, None) as bus:
        monkeypatch.setattr(bus, "socket", FullSocket(), raising=True)
        bus.send(can.Message(arbitration_id=1, is_extended_id=False), timeout=0.5)
        monkeypatch.undo()

    assert waited == [0.5]
