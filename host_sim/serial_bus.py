"""python-can's slcan, on a serial port that is ours alone."""

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path
from typing import Any

import can
from can.interfaces.slcan import slcanBus
from serial.tools import list_ports

from host_sim.errors import OmnibotError

# The board's UART (firmware/ports/stm32f405/board_omnibot.h); a channel that ends in @RATE has its own.
UART_BITS_PER_S = 1_000_000
CAN_BITS_PER_S = 1_000_000
# python-can looks at one byte when it may not wait at all; a whole line takes this long.
LOOK_S = 0.002


def _take_port(channel: str) -> int | None:
    """Lock a serial port before a byte goes out, which would break into the run of whoever has it; None: no device."""
    path = Path(channel.split("@", maxsplit=1)[0])
    if not path.is_char_device():
        return None
    try:
        handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except PermissionError as error:
        raise OmnibotError(f"{path} may not be opened: add yourself to the group {path.group()}") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise OmnibotError(f"{path} is in use by another run: give this one a port and a board of its own") from error
    return handle


class SerialBus(slcanBus):
    """A board on a serial port.

    Parameters
    ----------
    channel
        The port, ``/dev/ttyACM0``, or one of pyserial's URLs; ``@RATE`` behind it is the UART's, bit/s.
    bitrate
        Of the CAN bus behind an adapter, bit/s; a board's own UART has none and takes any.
    """

    cure = "is the board on, of this node, and on this port at this rate?"

    def __init__(self, channel: str, bitrate: int = CAN_BITS_PER_S, **kwargs: Any) -> None:
        self._lock = _take_port(channel)
        try:
            # A board is not reset by the opening of its port: nothing to wait for.
            options = {"tty_baudrate": UART_BITS_PER_S, "sleep_after_open": 0.0} | kwargs
            super().__init__(channel, bitrate=bitrate, **options)
        except BaseException:
            self._let_go()
            self._is_shutdown = True  # python-can need not complain that it was not shut down
            raise
        self.channel_info = f"slcan on {channel}"

    def _let_go(self) -> None:
        """Close what is open, however far the opening came; python-can does not where its last words fail."""
        with contextlib.suppress(AttributeError):
            self.serialPortOrig.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _read(self, timeout: float | None) -> str | None:
        """Read a line; one that is no text is dropped."""
        try:
            return super()._read(timeout)
        except can.CanOperationError as error:
            if not isinstance(error.__cause__, UnicodeDecodeError):
                raise
            self._buffer.clear()
            return None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Wait for a frame; answers to commands and lines damaged on the way are passed over."""
        deadline = None if timeout is None else time.monotonic() + max(timeout, LOOK_S)
        while True:
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            try:
                message, filtered = super()._recv_internal(left)
            except (ValueError, IndexError):
                continue
            if message is not None or left == 0.0:
                return message, filtered

    def shutdown(self) -> None:
        """Close the channel and give the port back."""
        try:
            super().shutdown()
        finally:
            self._let_go()


def open_serial(channel: str | int | None, bitrate: int | None, **options: Any) -> SerialBus:
    """Open the serial port that the command line names; ``options`` are python-can's, of its configuration."""
    if not isinstance(channel, str) or not re.fullmatch(r"[^@]+(@\d+)?", channel):
        raise OmnibotError("slcan needs a port: --channel /dev/ttyACM0, or /dev/ttyUSB0@1000000 with the UART's rate")
    try:
        return SerialBus(channel, CAN_BITS_PER_S if bitrate is None else bitrate, **options)
    except OmnibotError:
        raise
    except (can.CanError, OSError, TypeError, ValueError) as error:
        ports = ", ".join(port.device for port in list_ports.comports()) or "none"
        raise OmnibotError(
            f"cannot open {channel}: {error}; is the board plugged in? Serial ports here: {ports}"
        ) from error
