"""The board's own image on an emulated Cortex-M4F: QEMU, with its serial port behind python-can's slcan.

QEMU gets a listening socket that is ours, on a port that the system chose, so that any number of runs can go at
once. It counts instructions instead of time (``-icount``): the same frames in, the same frames out, on any machine.
"""

import contextlib
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import can

from host_sim.errors import OmnibotError
from host_sim.robot import ROOT
from host_sim.serial_bus import SerialBus

IMAGE_FILE = ROOT / "build" / "board" / "omnibot.elf"
EMULATOR = "qemu-system-arm"
MACHINE = "netduinoplus2"  # an STM32F405
BOOT_S = 10.0  # by the wall clock: the firmware is up in 0.1 s, where the machine has time for it
ASK_S = 0.1
END_S = 5.0  # that an emulator that was killed, or has closed its port, may take to be gone

# e_ident of a 32-bit little-endian ELF, and e_machine of ARM (ELF for the Arm Architecture, 5.3).
ELF32_LITTLE_ENDIAN, ELF_MACHINE_ARM = b"\x7fELF\x01\x01", 40


def check_image(image: Path) -> None:
    """Refuse a file that QEMU would take for raw instructions, and crash on."""
    try:
        with image.open("rb") as file:
            head = file.read(20)
    except OSError as error:
        cure = "tools/build board makes it" if image == IMAGE_FILE else "give the board's omnibot.elf"
        raise OmnibotError(f"no firmware image {image} ({error.strerror or error}): {cure}") from error
    if (
        not head.startswith(ELF32_LITTLE_ENDIAN)
        or len(head) < 20
        or struct.unpack("<H", head[18:20]) != (ELF_MACHINE_ARM,)
    ):
        raise OmnibotError(f"{image} is no ELF file for ARM: give the board's omnibot.elf")


def _tied_emulator() -> list[str]:
    """Return the emulator's command, tied to us: the kernel kills it when we are gone, however we went."""
    emulator, setpriv = shutil.which(EMULATOR), shutil.which("setpriv")
    if emulator is None:
        raise OmnibotError(f"no {EMULATOR} in PATH: tools/setup board, or apt-get install qemu-system-arm")
    if setpriv is None:
        raise OmnibotError("no setpriv in PATH: apt-get install util-linux")
    return [setpriv, "--pdeathsig", "KILL", "--", emulator]


def _options(image: Path, listening: int) -> list[str]:
    """Return QEMU's options; the board's serial port is whoever connects to the listening socket."""
    lean = ["-nodefaults", "-no-user-config", "-display", "none", "-icount", "shift=0,sleep=off"]
    serial = f"socket,id=serial,fd={listening},server=on,wait=off,nodelay=on"
    return [*lean, "-M", MACHINE, "-kernel", str(image), "-chardev", serial, "-serial", "chardev:serial"]


class Emulator:
    """A running QEMU. ``port`` of this machine is the serial port of the board.

    It ends with the thread that has made it, at the latest.
    """

    def __init__(self, image: Path) -> None:
        check_image(image)
        command = _tied_emulator()
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115  # closed by stop
        with socket.create_server(("127.0.0.1", 0)) as listening:
            self.port: int = listening.getsockname()[1]
            self._process = subprocess.Popen(
                [*command, *_options(image, listening.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=self._messages,
                stderr=self._messages,
                pass_fds=[listening.fileno()],
                start_new_session=True,  # Ctrl-C is for the run, which then ends the emulator
            )

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    def why_ended(self) -> str | None:
        """Say how an emulator ended that is silent, and its first words; None where it goes on running."""
        try:
            status = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            return None
        how = f"by signal {-status}" if status < 0 else f"with status {status}"
        self._messages.seek(0)
        words = self._messages.read().decode(errors="replace").split("\n")
        return f"{EMULATOR} ended {how}: {next((line.strip() for line in words if line.strip()), 'it said nothing')}"

    def stop(self) -> None:
        """End it; once more does nothing."""
        self._process.kill()
        self._process.wait(END_S)
        self._messages.close()


class EmulatedBoard(SerialBus):
    """python-can's slcan to an emulated board, which lives as long as the bus does.

    Parameters
    ----------
    image
        The board's firmware, an ELF file.
    """

    cure = "is it an omnibot image of this node?"
    is_ours_alone = True  # no other host can be on it

    def __init__(self, image: Path = IMAGE_FILE, **kwargs: Any) -> None:
        self.emulator = Emulator(image)
        try:
            super().__init__(f"socket://127.0.0.1:{self.emulator.port}", **kwargs)
            self._line: socket.socket = self.serialPortOrig._socket
            # No frame waits until the one before was acknowledged.
            self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except BaseException as error:
            cause = self.emulator.why_ended()
            self.emulator.stop()
            if cause is None:
                raise
            raise OmnibotError(cause) from error
        self.channel_info = f"{EMULATOR} with {image}"
        try:
            self._wait_for_firmware()
        except BaseException as error:
            self.shutdown()
            if isinstance(error, can.CanError):
                raise OmnibotError(str(error)) from error
            raise

    def _wait_for_firmware(self) -> None:
        """Ask until the firmware answers, and open again: what came before its UART was up is lost."""
        deadline = time.monotonic() + BOOT_S
        while self.get_version(ASK_S) == (None, None):
            if time.monotonic() > deadline:
                raise OmnibotError(f"{self.channel_info} does not answer within {BOOT_S:g} s: {self.cure}")
        self.open()
        self.get_version(BOOT_S)  # what the opening has set free is said

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Wait for a frame; one who may not wait gets what the firmware has said to all that it was sent.

        Its answer to a question comes behind that. Without it, the machine's haste would order the log.
        """
        if timeout == 0.0 and self._queue.empty():
            self.get_version(BOOT_S)
        return super()._recv_internal(timeout)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; an emulator that has ended is named as the cause."""
        try:
            super().send(msg, timeout)
        except can.CanError as error:
            raise self._explained(error) from error

    def _read(self, timeout: float | None) -> str | None:
        try:
            return super()._read(timeout)
        except can.CanError as error:
            raise self._explained(error) from error

    def _explained(self, error: can.CanError) -> can.CanError:
        cause = self.emulator.why_ended()
        return error if cause is None else can.CanOperationError(cause)

    def shutdown(self) -> None:
        """Close the port and end the emulator, whatever state they are in."""
        with contextlib.suppress(can.CanError):  # where it is gone already
            super().shutdown()
        self._line.close()  # pyserial leaves it open where the other end has gone
        self.emulator.stop()
