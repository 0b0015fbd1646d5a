"""The firmware as a python-can interface."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import LIBRARY_FILE, InprocBus, load_firmware
from host_sim.link import Link, RefusedError, open_bus
from host_sim.robot import load_robot


@pytest.fixture(autouse=True)
def _built() -> None:
    if not LIBRARY_FILE.exists():
        pytest.fail(f"no {LIBRARY_FILE}: cmake --preset host && cmake --build --preset host")


@contextmanager
def robot(node: int = 0) -> Iterator[InprocBus]:
    """A bus whose robot has said all that it says on its own."""
    with InprocBus(node=node) as bus:
        status = bus.recv(0.0)
        assert status is not None
        assert status.arbitration_id == Codec(node=node)["STATUS"].arbitration_id
        assert bus.recv(0.0) is None
        yield bus


@pytest.fixture
def bus() -> Iterator[InprocBus]:
    with robot() as bus:
        yield bus


def get_parameter(bus: can.BusABC, codec: Codec, index: int) -> float:
    """The value that the firmware on a bus holds."""
    message = codec["PARAMETER_GET"]
    bus.send(can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=message.pack(index, 0, 0)))
    answer = bus.recv(0.1)
    assert answer is not None
    return codec["PARAMETER_VALUE"].named(bytes(answer.data))["value"]


def test_python_can_finds_the_interface_by_its_name() -> None:
    with can.Bus(interface="omnibot", channel="inproc", node=5) as bus:
        assert isinstance(bus, InprocBus)
        assert Link(bus, Codec(node=5)).hello().version == "0.1.0"


def test_python_can_lists_the_interface() -> None:
    assert {"interface": "omnibot", "channel": "inproc"} in can.detect_available_configs("omnibot")


def test_open_bus_gives_it_under_its_short_name() -> None:
    with open_bus("inproc", node=2, interface=None, channel=None, bitrate=None) as bus:
        assert Link(bus, Codec(node=2)).hello().version == "0.1.0"


def test_two_buses_are_two_robots() -> None:
    codec, epsilon = Codec(), load_robot().parameter("epsilon")
    with robot() as first, robot() as second:
        Link(first, codec).set_parameter(epsilon, 0.5)

        assert get_parameter(first, codec, epsilon.index) == 0.5
        assert get_parameter(second, codec, epsilon.index) == pytest.approx(epsilon.default)
        assert second.recv(0.0) is None


def test_two_buses_do_not_share_a_session() -> None:
    codec = Codec()
    with robot() as first, robot() as second:
        Link(first, codec).hello()

        with pytest.raises(RefusedError, match="UNKNOWN_PEER"):
            Link(second, codec).start()


def test_firmware_answers_only_to_its_node() -> None:
    codec = Codec(node=1)
    hello = can.Message(arbitration_id=codec["HELLO"].arbitration_id, is_extended_id=False, data=codec["HELLO"].pack(0))
    with robot(node=1) as one, robot(node=2) as two:
        one.send(hello)
        two.send(hello)

        assert one.recv(0.0) is not None
        assert two.recv(0.0) is None


def test_received_frame_is_a_classic_one_with_eleven_bits(bus: InprocBus) -> None:
    codec = Codec()
    bus.send(can.Message(arbitration_id=codec["HELLO"].arbitration_id, is_extended_id=False, data=bytes(4)))

    answer = bus.recv(0.0)

    assert answer is not None
    assert answer.arbitration_id == codec["IDENTITY"].arbitration_id
    assert not answer.is_extended_id
    assert answer.dlc == 8
    assert codec["IDENTITY"].named(bytes(answer.data))["peer_matches"] == 0


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0x400, is_extended_id=True, data=bytes(4)),
        can.Message(arbitration_id=0x400, is_extended_id=False, is_fd=True, data=bytes(12)),
        can.Message(arbitration_id=0x400, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=0x400, is_extended_id=False, is_error_frame=True),
        can.Message(arbitration_id=0x400, is_extended_id=False, data=bytes(64), check=False),
    ],
    ids=["extended", "fd", "remote", "error", "too long"],
)
def test_send_of_another_kind_of_frame_is_refused(bus: InprocBus, frame: can.Message) -> None:
    with pytest.raises(can.CanOperationError, match="classic data frames with 11-bit identifiers"):
        bus.send(frame)

    assert bus.recv(0.0) is None


def test_load_firmware_without_a_library_says_how_to_build_it() -> None:
    with pytest.raises(OmnibotError, match=r"no firmware library .*nowhere.*tools/build host"):
        load_firmware(Path("nowhere"))


def test_load_firmware_of_another_version_says_what_is_missing(tmp_path: Path) -> None:
    source, library = tmp_path / "old.c", tmp_path / "old.so"
    source.write_text("unsigned long omnibot_size(void) { return 8; }")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    with pytest.raises(OmnibotError, match=r"old.so is of another version, without omnibot_init: tools/build host"):
        load_firmware(library)
