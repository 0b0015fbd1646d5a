"""The firmware as a shared library behind a python-can bus: ``can.Bus(interface="omnibot", channel="inproc")``."""

import ctypes
import struct
from pathlib import Path
from typing import Any

import can
import numpy as np

from host_sim.errors import OmnibotError
from host_sim.robot import ROOT

LIBRARY_FILE = ROOT / "build" / "host" / "libomnibot.so"
FRAME_BYTES = 8


class Frame(ctypes.Structure):
    """``frame_t`` of ``protocol/frame.h``."""

    _fields_ = (("id", ctypes.c_uint16), ("length", ctypes.c_uint8), ("data", ctypes.c_uint8 * FRAME_BYTES))


_FRAME = struct.Struct(f"=HB{FRAME_BYTES}s")  # the same, all fields at once: several times faster


_CALLS: dict[str, tuple[Any, tuple[Any, ...]]] = {  # result and arguments
    "omnibot_size": (ctypes.c_size_t, ()),
    "omnibot_init": (None, (ctypes.c_void_p, ctypes.c_uint8)),
    "omnibot_receive": (None, (ctypes.c_void_p, ctypes.c_void_p)),
    "omnibot_transmit": (ctypes.c_bool, (ctypes.c_void_p, ctypes.c_void_p)),
    "omnibot_tick": (None, (ctypes.c_void_p,)),
    "omnibot_lockstep": (ctypes.c_int32, (ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_void_p)),
}


def load_firmware(path: Path = LIBRARY_FILE) -> ctypes.CDLL:
    """Load the firmware library and declare its calls (``firmware/ports/posix/inproc.h``)."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise OmnibotError(f"no firmware library ({error}): tools/build host makes it") from error
    for name, (result, arguments) in _CALLS.items():
        try:
            function = library[name]
        except AttributeError:
            raise OmnibotError(
                f"{path} is of another version, without {name}: tools/build host makes it anew"
            ) from None
        function.restype, function.argtypes = result, arguments
        setattr(library, name, function)
    return library


class InprocBus(can.BusABC):
    """A bus with one robot on it: what is sent reaches the firmware at once, and what it answers can be received.

    Parameters
    ----------
    channel
        The firmware library to load (*.so); anything else is a name for the bus, with build/host's. Each InprocBus is a
        bus of its own.
    node
        The robot's node, 0 … 15.
    """

    is_ours_alone = True  # no other host can be on it

    def __init__(self, channel: Any = "inproc", node: int = 0, **kwargs: Any) -> None:
        self.channel_info = f"omnibot firmware in-process: {channel}, node {node}"
        self.library = load_firmware(Path(channel) if str(channel).endswith(".so") else LIBRARY_FILE)
        # 64-bit words: aligned for anything that an instance holds.
        self.instance = np.zeros(self.library.omnibot_size() // 8 + 1, dtype=np.uint64)
        self._instance_address = self.instance.ctypes.data
        self._frame = Frame()
        self._frame_address = ctypes.addressof(self._frame)
        self.library.omnibot_init(self._instance_address, node)
        super().__init__(channel=channel, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Give the firmware a frame; it acts on it before this returns."""
        if msg.is_extended_id or msg.is_remote_frame or msg.is_error_frame or msg.is_fd or len(msg.data) > FRAME_BYTES:
            raise can.CanOperationError("the firmware speaks classic data frames with 11-bit identifiers")
        _FRAME.pack_into(self._frame, 0, msg.arbitration_id, len(msg.data), msg.data)
        self.library.omnibot_receive(self._instance_address, self._frame_address)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        # No answer will come while nobody sends: there is nothing to wait for.
        if not self.library.omnibot_transmit(self._instance_address, self._frame_address):
            return None, False
        arbitration_id, length, data = _FRAME.unpack_from(self._frame)
        return can.Message(arbitration_id=arbitration_id, is_extended_id=False, data=data[:length]), False

    def tick(self) -> None:
        """Let a control period pass: a step, where the firmware was asked to pace itself."""
        self.library.omnibot_tick(self._instance_address)

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return [{"interface": "omnibot", "channel": "inproc"}]
