"""``omnibot doctor``: what works on this machine, found by trying it, and for what does not the command that helps."""

import grp
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from packaging.requirements import Requirement
from rich.text import Text
from serial.tools import list_ports

from host_sim.codec import Codec
from host_sim.drive import Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.flash import RUNNERS
from host_sim.inproc import InprocBus
from host_sim.link import Link, is_can_interface
from host_sim.pil import EMULATOR, MACHINE
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import ROOT, load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario

PATIENCE_S = 120.0  # for one try: a User-Mode Linux kernel is up in 3 s, on a machine that has time for it
MAIN_JOB = "run in-process"

SETUP_RUN, SETUP_BOARD, SETUP_TEST = (f"tools/setup {what}" for what in ("run", "board", "test"))
UDEV_RULES = "apt-get install openocd, and plug it in again (the package brings the udev rules)"

# Vendor and product of what the runners of `flash` work with; None: every product.
PROBES = (
    ("0483", "df11", "board in its USB loader (dfu-util)"),
    ("0483", "374[0-9a-f]|375[0-9a-f]", "ST-Link"),
    ("0d28", "0204", "CMSIS-DAP"),
    ("1366", ".*", "J-Link"),
)
TRIFLE = "#include <math.h>\n#include <string.h>\nint main(void) { char a[4]; memset(a, 0, sizeof a); return a[3]; }\n"
TARGET = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "--specs=nosys.specs")
# Two sockets on vcan0: what one sends, the other receives.
VCAN_TRY = """
import socket
ours, other = (socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) for _ in range(2))
ours.bind(("vcan0",)), other.bind(("vcan0",)), other.settimeout(5)
ours.send(frame := bytes((1, 0, 0, 0, 8, 0, 0, 0)) + b"omnibot!")
assert other.recv(16) == frame
"""


class Broken(Exception):  # noqa: N818  # it is a finding, not an error
    """What was tried does not work: what was seen, and the command that helps, if not the one of its check."""

    def __init__(self, found: str, cure: str | None = None) -> None:
        super().__init__(found)
        self.cure = cure


@dataclass(frozen=True)
class Check:
    """Something to try: what it is, what it is needed for, what helps, and how it is tried.

    ``attempt`` says what was found, or raises `Broken`.
    """

    name: str
    needed_for: str
    cure: str
    attempt: Callable[[], str]


@dataclass(frozen=True)
class Finding:
    """What came of a check."""

    name: str
    works: bool
    found: str
    needed_for: str
    cure: str | None  # None where it works


def _said(*command: str | Path, text: str = "", wanted: int | None = 0) -> str:
    """Run a command and return all that it says; ``wanted`` is its exit status, None for any."""
    try:
        result = subprocess.run(
            command,
            input=text,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=PATIENCE_S,
            check=False,
        )
    except FileNotFoundError:
        raise Broken(f"no {command[0]}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Broken(f"{command[0]}: {error}") from error
    if wanted is not None and result.returncode != wanted:
        raise Broken(f"{command[0]}: {_last_line(result.stdout) or f'ended with status {result.returncode}'}")
    return result.stdout


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0]


def _last_line(text: str) -> str:
    return text.strip().rpartition("\n")[2]


# ---- this machine


def _python_package() -> str:
    """Every package that ours asks for now, not when it was installed, is there, in a version that will do."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for wanted in map(Requirement, project["dependencies"]):
        try:
            found = importlib.metadata.version(wanted.name)
        except importlib.metadata.PackageNotFoundError:
            raise Broken(f"no Python package {wanted.name}") from None
        if not wanted.specifier.contains(found, prereleases=True):
            raise Broken(f"{wanted.name} is {found}, not {wanted.specifier}")
    python = ".".join(map(str, sys.version_info[:3]))
    return f"omnibot {project['version']}, Python {python}"


def _run_in_process() -> str:
    """Three tenths of a second in closed loop with the firmware's library."""
    robot, scenario = load_robot(), Scenario(PathRequest("line", 0.1, duration_s=0.3))
    trajectory = plan(scenario.path)
    plant = Plant(robot, scenario.traction_of(robot), scenario.speed_length_m, scenario.delta_m_per_s)
    plant.reset(*start_state(robot, trajectory))
    try:
        with InprocBus() as bus:
            link = Link(bus, Codec())
            identity = prepare(link, robot, scenario, trajectory).identity
            driven = drive(link, plant, robot, trajectory)
    except OmnibotError as error:
        raise Broken(str(error)) from error
    if driven.status is not Status.COMPLETED:
        raise Broken(f"{driven.status}: {driven.reason}")
    return f"firmware {identity.version}, protocol {identity.protocol_hash:08X}, {len(driven.trace)} ticks driven"


def _build_of(preset: str) -> Callable[[], str]:
    """Ask ninja, which knows what every file was made of, whether a build is as new as its sources."""

    def attempt() -> str:
        folder = ROOT / "build" / preset
        if not (folder / "build.ninja").exists():
            raise Broken(f"there is no build/{preset}")
        if shutil.which("ninja") is None:
            raise Broken("no ninja", SETUP_RUN)
        said = _said("ninja", "-C", folder, "-n")
        if "no work to do" not in said:
            raise Broken("older than its sources")
        return "as new as its sources"

    return attempt


def _c_compiler() -> str:
    """Compile a trifle, and run it."""
    compiler = os.environ.get("CC", "cc")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "trifle"
        _said(compiler, "-x", "c", "-", "-o", program, "-lm", text=TRIFLE)
        _said(program)
    return _first_line(_said(compiler, "--version"))


def _target_compiler() -> str:
    """Compile a trifle and link it with newlib."""
    compiler = "arm-none-eabi-gcc"
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "trifle.elf"
        said = _said(compiler, *TARGET, "-x", "c", "-", "-o", program, text=TRIFLE, wanted=None)
        if not program.exists():
            raise Broken(f"{compiler}: {_first_line(said)}")
    return _first_line(_said(compiler, "--version"))


def _cmake() -> str:
    """Have CMake read our presets, which an old one cannot, and start ninja."""
    _said("cmake", "-S", ROOT, "--list-presets")
    return f"{_first_line(_said('cmake', '--version'))}, ninja {_first_line(_said('ninja', '--version'))}"


def _vcan() -> str:
    """Send a frame over the vcan0 that is there, or that tools/with-vcan can make."""
    if is_can_interface("vcan0"):
        try:
            _said(sys.executable, "-c", VCAN_TRY)
        except Broken as error:
            raise Broken(f"vcan0 is there: {error}", "sudo ip link set vcan0 up") from error
        return "vcan0 is there"
    said = _said(ROOT / "tools" / "with-vcan", "--", sys.executable, "-c", VCAN_TRY)
    return f"tools/with-vcan makes one: {_first_line(said).removeprefix('with-vcan: ')}"


def _qemu() -> str:
    """Start the emulator, and look whether it knows our processor."""
    if MACHINE not in _said(EMULATOR, "-machine", "help"):
        raise Broken(f"{EMULATOR} knows no machine {MACHINE}")
    return _first_line(_said(EMULATOR, "--version"))


def _can_utils() -> str:
    """Start candump, which tells how it is used."""
    if "candump" not in _said("candump", "-?", wanted=None):
        raise Broken("candump does not start")
    return "candump starts"


def _step_cost() -> str:
    """Import what the meter needs."""
    _said(sys.executable, "-c", "import capstone, elftools, unicorn")
    return "capstone, pyelftools, unicorn"


def _checkers() -> str:
    """Start each of the tools that the tests use."""
    tools = ("clang", "clang-format", "clang-tidy", "cppcheck", "shellcheck", "chromium")
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if missing:
        raise Broken(f"no {', '.join(missing)}")
    for tool in tools:
        _said(tool, "--version")
    return ", ".join(tools)


# ---- what is plugged in


def _flash_tools() -> str:
    """Start the tools of which ``omnibot flash`` needs one."""
    found = []
    for runner in RUNNERS:
        try:
            _said(runner.program, "--version")
        except Broken:
            continue
        found.append(runner.program)
    if not found:
        raise Broken(f"none of {', '.join(runner.program for runner in RUNNERS)}")
    return ", ".join(found)


def _usb_devices(sysfs: Path) -> Iterator[tuple[str, Path, Path]]:
    """Give the probes among the USB devices: what they are, and their places below /sys and /dev."""
    for device in sorted(sysfs.glob("bus/usb/devices/*")):
        try:
            vendor, product, bus, number = (
                (device / name).read_text().strip() for name in ("idVendor", "idProduct", "busnum", "devnum")
            )
        except OSError:
            continue  # an interface of a device, or gone again
        node = Path("dev/bus/usb", f"{int(bus):03d}", f"{int(number):03d}")
        for known_vendor, known_product, name in PROBES:
            if vendor == known_vendor and re.fullmatch(known_product, product):
                yield f"{name} {vendor}:{product}", device, node


def _probe(root: Path = Path("/")) -> str:
    """Look for a probe on USB that we may open."""
    devices = list(_usb_devices(root / "sys"))
    if not devices:
        raise Broken("none on USB")
    closed = [name for name, _, node in devices if not os.access(root / node, os.R_OK | os.W_OK)]
    if closed:
        raise Broken(f"{', '.join(closed)} may not be opened", UDEV_RULES)
    return ", ".join(name for name, _, _ in devices)


def _serial_port() -> str:
    """Look for serial ports that we may open; they are left closed, since opening one may reset what is there."""
    ports = [Path(port.device) for port in list_ports.comports()]
    if not ports:
        raise Broken("none")
    for port in ports:
        if not os.access(port, os.R_OK | os.W_OK):
            raise Broken(f"{port} may not be opened", _join_group(port.group()))
    return ", ".join(map(str, ports))


def _join_group(group: str) -> str:
    """Return the command that lets us open what a group may open."""
    user = os.environ.get("USER", "$USER")
    if user in grp.getgrnam(group).gr_mem:
        return f"newgrp {group} (you are in the group since your last login; or log in again)"
    return f"sudo usermod --append --groups {group} {user}, and log in again"


def _can_adapter(root: Path = Path("/")) -> str:
    """Look for a CAN interface, other than a virtual one, that is up."""
    names = sorted(path.name for path in (root / "sys/class/net").glob("*") if not path.name.startswith("vcan"))
    names = [name for name in names if is_can_interface(name, root)]
    if not names:
        raise Broken("none")
    for name in names:
        if not int((root / "sys/class/net" / name / "flags").read_text(), 16) & 1:  # IFF_UP
            raise Broken(f"{name} is down", f"sudo ip link set {name} up type can bitrate 1000000")
    return ", ".join(names)


CHECKS = (
    Check("Python package", "everything", SETUP_RUN, _python_package),
    Check(MAIN_JOB, "everything", "tools/build host", _run_in_process),
    Check("C compiler", "tools/build host", SETUP_RUN, _c_compiler),
    Check("CMake and ninja", "tools/build", SETUP_RUN, _cmake),
    Check("host build", "runs with the newest firmware", "tools/build host", _build_of("host")),
    Check("vcan", "run --bus vcan0", SETUP_RUN, _vcan),
    Check("can-utils", "candump, canplayer and cansend on the bus", SETUP_RUN, _can_utils),
    Check("step-cost meter", "cost", SETUP_RUN, _step_cost),
    Check("target compiler", "tools/build board, tools/build target", SETUP_BOARD, _target_compiler),
    Check("board build", "run --bus pil, flash", "tools/build board", _build_of("board")),
    Check("QEMU", "run --bus pil", SETUP_BOARD, _qemu),
    Check("checkers", "tools/test", SETUP_TEST, _checkers),
    Check("flash tool", "flash", RUNNERS[0].install, _flash_tools),
    Check("debug probe", "flash", "plug one into USB, an ST-Link for one", _probe),
    Check("serial port", "run -i slcan", "plug the board or an adapter into USB", _serial_port),
    Check("CAN adapter", "run -i socketcan -c can0", "plug one in that Linux has a driver for", _can_adapter),
)


def examine(check: Check) -> Finding:
    """Try one thing."""
    try:
        return Finding(check.name, True, check.attempt(), check.needed_for, None)
    except Broken as broken:
        return Finding(check.name, False, str(broken), check.needed_for, broken.cure or check.cure)


def main_job_works(findings: list[Finding]) -> bool:
    """Tell whether the firmware can be run in-process here."""
    return all(finding.works for finding in findings if finding.name == MAIN_JOB)


def text_of(finding: Finding) -> Text:
    """Return a finding as a person reads it: what was found, and where that is not enough, for what and what helps."""
    mark = ("works   ", "green") if finding.works else ("missing ", "yellow")
    line = Text.assemble(mark, (f"{finding.name:<16} ", "bold"), finding.found)
    if finding.cure is not None:
        line.append(f"; needed for {finding.needed_for}\n{'':25}→ ").append(finding.cure, "cyan")
    return line


def as_dict(findings: list[Finding]) -> dict[str, object]:
    """Return findings as plain values."""
    return {
        "status": "works" if main_job_works(findings) else "broken",
        "checks": [asdict(finding) for finding in findings],
    }
