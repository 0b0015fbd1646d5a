"""The firmware as a shared library behind a python-can bus: ``can.Bus(interface="omnibot", channel="inproc")``."""

import ctypes
from pathlib import Path
from typing import Any

import can

from host_sim.errors import OmnibotError
from host_sim.robot import ROOT

LIBRARY_FILE = ROOT / "build" / "host" / "libomnibot.so"
FRAME_BYTES = 8


class Frame(ctypes.Structure):
    """``frame_t`` of ``protocol/frame.h``."""

    _fields_ = (("id", ctypes.c_uint16), ("length", ctypes.c_uint8), ("data", ctypes.c_uint8 * FRAME_BYTES))


def load_firmware(path: Path = LIBRARY_FILE) -> ctypes.CDLL:
    """Load the firmware library and declare its five calls (``firmware/ports/posix/inproc.h``)."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise OmnibotError(f"no firmware library ({error}): tools/build host makes it") from error
    library.omnibot_size.restype = ctypes.c_size_t
    library.omnibot_size.argtypes = ()
    library.omnibot_init.restype = None
    library.omnibot_init.argtypes = (ctypes.c_void_p, ctypes.c_uint8)
    library.omnibot_receive.restype = None
    library.omnibot_receive.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
    library.omnibot_transmit.restype = ctypes.c_bool
    library.omnibot_transmit.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
    library.omnibot_tick.restype = None
    library.omnibot_tick.argtypes = (ctypes.c_void_p,)
    return library


class InprocBus(can.BusABC):
    """A bus with one robot on it: what is sent reaches the firmware at once, and what it answers can be received.

    Parameters
    ----------
    channel
        A name for the bus; each InprocBus is a bus of its own.
    node
        The robot's node, 0 … 15.
    """

    def __init__(self, channel: Any = "inproc", node: int = 0, **kwargs: Any) -> None:
        self.channel_info = f"omnibot firmware in-process: {channel}, node {node}"
        self._library = load_firmware()
        # 64-bit words: aligned for anything that an instance holds.
        self._instance = (ctypes.c_uint64 * (self._library.omnibot_size() // 8 + 1))()
        self._instance_address = ctypes.addressof(self._instance)
        self._frame = Frame()
        self._frame_address = ctypes.addressof(self._frame)
        self._library.omnibot_init(self._instance_address, node)
        super().__init__(channel=channel, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Give the firmware a frame; it acts on it before this returns."""
        if msg.is_extended_id or msg.is_remote_frame or msg.is_error_frame or msg.is_fd or len(msg.data) > FRAME_BYTES:
            raise can.CanOperationError("the firmware speaks classic data frames with 11-bit identifiers")
        frame = self._frame
        frame.id = msg.arbitration_id
        frame.length = len(msg.data)
        ctypes.memmove(frame.data, bytes(msg.data), frame.length)
        self._library.omnibot_receive(self._instance_address, self._frame_address)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        # No answer will come while nobody sends: there is nothing to wait for.
        if not self._library.omnibot_transmit(self._instance_address, self._frame_address):
            return None, False
        frame = self._frame
        data = bytes(frame.data[: frame.length])
        return can.Message(arbitration_id=frame.id, is_extended_id=False, data=data, check=False), False

    def tick(self) -> None:
        """Let a control period pass: a step, where the firmware was asked to pace itself."""
        self._library.omnibot_tick(self._instance_address)

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return [{"interface": "omnibot", "channel": "inproc"}]
