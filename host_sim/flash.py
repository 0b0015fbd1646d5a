"""``omnibot flash``: the image into a board's flash, verified, and the board reset, by a tool that is installed.

Tools and what they say when something is wrong, as of OpenOCD 0.12, stlink 1.7, dfu-util 0.11 and pyOCD 0.46.
"""

import re
import shlex
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from host_sim.errors import OmnibotError
from host_sim.robot import ROOT

IMAGE_FILE = ROOT / "build" / "board" / "omnibot.bin"
FLASH_ADDRESS, FLASH_BYTES = 0x0800_0000, 768 * 1024  # RM0090, table 5; above lie the parameters that are kept
RAM_ADDRESS, RAM_BYTES = 0x2000_0000, 128 * 1024
AT = f"{FLASH_ADDRESS:#010x}"

PLUG_PROBE = "no debug probe: plug it into USB, or give another tool with --runner"
GRANT_USB = (
    "the probe is there but may not be opened: install the tool's udev rules (Debian's packages bring them), "
    "and plug the probe in again"
)
WIRE_BOARD = "the probe does not reach the board: is it powered, and are SWDIO, SWCLK, NRST and GND connected?"
POWER_BOARD = "the board is not powered, or the probe's VTref is not connected to its 3.3 V"
NOT_VERIFIED = "what the board holds is not the image: try again; where it stays so, the flash is protected or worn"


@dataclass(frozen=True)
class Runner:
    """A tool that flashes.

    Parameters
    ----------
    program, install
        Its name in PATH, and the command that installs it.
    commands
        From the image and a file for what is read back: the commands, in order.
    success
        What the tool says, as a regular expression, when the board holds the image; None: it is read back and compared.
    complaints
        What it says, as regular expressions, when something is wrong, each with its cure.
    """

    program: str
    install: str
    commands: Callable[[Path, Path], list[list[str]]]
    success: str | None
    complaints: tuple[tuple[str, str], ...]


def _openocd(image: Path, _: Path) -> list[list[str]]:
    program = f"program {{{image}}} {AT} verify reset exit"
    return [["openocd", "-f", "interface/stlink.cfg", "-f", "target/stm32f4x.cfg", "-c", program]]


def _st_flash(image: Path, _: Path) -> list[list[str]]:
    return [["st-flash", "--reset", "write", str(image), AT]]


def _dfu_util(image: Path, readback: Path) -> list[list[str]]:
    device = ["dfu-util", "--device", "0483:df11", "--alt", "0", "--dfuse-address"]
    read = f"{AT}:{image.stat().st_size}:leave"
    return [[*device, AT, "--download", str(image)], [*device, read, "--upload", str(readback)]]


def _pyocd(image: Path, _: Path) -> list[list[str]]:
    board = ["--no-wait", "--target", "stm32f405rg"]
    compare = f"compare {AT} {shlex.quote(str(image))}"
    return [
        ["pyocd", "load", *board, "--erase", "sector", "--base-address", AT, str(image)],
        ["pyocd", "commander", *board, "--command", compare, "--command", "reset"],
    ]


RUNNERS = (
    Runner(
        "openocd",
        "apt-get install openocd",
        _openocd,
        r"\*\* Verified OK",
        (
            (r"LIBUSB_ERROR_ACCESS", GRANT_USB),
            (r"open failed|no device found|unable to find a matching", PLUG_PROBE),
            (r"[Tt]arget voltage (may be )?too low", POWER_BOARD),
            (r"unable to connect to the target", WIRE_BOARD),
            (r"Verify Failed", NOT_VERIFIED),
        ),
    ),
    Runner(
        "st-flash",
        "apt-get install stlink-tools",
        _st_flash,
        r"Flash written and verified",
        (
            (r"access error|LIBUSB_ERROR_ACCESS", GRANT_USB),
            (r"unable to claim", "another program uses the probe: end it, a debugger perhaps"),
            (r"Couldn't find any ST-Link", PLUG_PROBE),
            (r"Target voltage .*too low", POWER_BOARD),
            (r"Failed to connect|Can not connect|Failed to enter SWD|unknown chip id|not find chip id", WIRE_BOARD),
            (r"Verification of flash failed", NOT_VERIFIED),
        ),
    ),
    Runner(
        "pyocd",
        ".venv/bin/pip install pyocd",
        _pyocd,
        r"All \d+ bytes match",
        (
            (r"not recognized", "pyocd does not know the processor yet: pyocd pack install stm32f405rg"),
            (r"LIBUSB_ERROR_ACCESS|[Aa]ccess denied|[Pp]ermission denied", GRANT_USB),
            (r"No connected debug probes|No target device available", PLUG_PROBE),
            (r"No ACK|communication failure", WIRE_BOARD),
            (r"Mismatched byte", NOT_VERIFIED),
        ),
    ),
    Runner(
        "dfu-util",
        "apt-get install dfu-util",
        _dfu_util,
        None,
        (
            (r"LIBUSB_ERROR_ACCESS", GRANT_USB),
            (
                r"No DFU capable USB device",
                "no board in its USB loader: hold BOOT0 high, reset the board, and plug its own USB in",
            ),
        ),
    ),
)


def choose_runner(name: str | None) -> Runner:
    """Return the runner of a name, or the first that is installed."""
    known = {runner.program: runner for runner in RUNNERS}
    if name is not None:
        if name not in known:
            raise OmnibotError(f"--runner {name}: must be one of {', '.join(known)}")
        if shutil.which(name) is None:
            raise OmnibotError(f"no {name} in PATH: {known[name].install}")
        return known[name]
    for runner in RUNNERS:
        if shutil.which(runner.program) is not None:
            return runner
    raise OmnibotError(f"no tool to flash with, none of {', '.join(known)}: {RUNNERS[0].install}")


def check_image(image: Path) -> None:
    """Refuse what can't be the board's flash: it begins with the top of a stack in RAM and a Thumb address in flash."""
    try:
        content = image.read_bytes()
    except OSError as error:
        cure = "tools/build board makes it" if image == IMAGE_FILE else "give the board's omnibot.bin"
        raise OmnibotError(f"no image {image} ({error.strerror or error}): {cure}") from error
    stack, reset = struct.unpack_from("<II", content.ljust(8, b"\0"))
    in_ram = RAM_ADDRESS < stack <= RAM_ADDRESS + RAM_BYTES
    in_flash = FLASH_ADDRESS < reset < FLASH_ADDRESS + len(content) and reset % 2 == 1
    if not in_ram or not in_flash or len(content) > FLASH_BYTES:
        raise OmnibotError(f"{image} is no image of the STM32F405's flash: give the board's omnibot.bin")


def _run(command: list[str], say: Callable[[str], None]) -> tuple[int, str]:
    """Run a command, pass on what it says, and return its exit status and all that it said."""
    said = []
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, errors="replace", text=True
    ) as process:
        for line in process.stdout or ():
            said.append(line)
            say(line.rstrip("\n"))
    return process.returncode, "".join(said)


def _cure(runner: Runner, status: int, said: str) -> str:
    """Say what was wrong and what helps, from the tool's own words."""
    for pattern, cure in runner.complaints:
        found = re.search(pattern, said)
        if found is not None:
            return f"{runner.program}: {cure} ({found.group()!r})"
    how = f"ended with status {status}" if status != 0 else "does not say that the board holds the image"
    return f"{runner.program} {how}; its messages are above"


def flash(name: str | None, image: Path, dry_run: bool, say: Callable[[str], None]) -> None:
    """Write an image into a board's flash, verify it, and reset the board.

    Parameters
    ----------
    name
        Which runner; None: the first that is installed.
    image
        What the flash shall hold from its beginning on.
    dry_run
        Only say the commands.
    say
        Gets the commands and, line by line, what they say.
    """
    runner = choose_runner(name)
    check_image(image)
    with tempfile.TemporaryDirectory() as folder:
        readback = Path(folder) / "readback.bin"
        said = ""
        for command in runner.commands(image, readback):
            say(shlex.join(command))
            if dry_run:
                continue
            status, said = _run(command, say)
            if status != 0:
                raise OmnibotError(_cure(runner, status, said))
        if not dry_run:
            _verify(runner, said, image, readback)


def _verify(runner: Runner, said: str, image: Path, readback: Path) -> None:
    """Believe no exit status: the tool must have said that the board holds the image, or have read it back."""
    if runner.success is not None:
        if re.search(runner.success, said) is None:
            raise OmnibotError(_cure(runner, 0, said))
    elif not readback.exists() or readback.read_bytes() != image.read_bytes():
        raise OmnibotError(f"{runner.program}: {NOT_VERIFIED}")
