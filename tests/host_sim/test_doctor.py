"""``omnibot doctor``: what is missing or broken is found, and the command that helps is named."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from host_sim import doctor
from host_sim.cli import app
from host_sim.doctor import CHECKS, Check, Finding, examine, main_job_works, text_of
from host_sim.errors import OmnibotError

Plant = Callable[..., None]


def check(name: str) -> Check:
    return next(check for check in CHECKS if check.name == name)


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plant:
    """Make a PATH of its own: without anything, or with a program that says something and ends with a status."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("CC", raising=False)

    def program(name: str, says: str = "", status: int = 0) -> None:
        script = folder / name
        script.write_text(f"#!/bin/sh\nprintf '%s\\n' '{says}'\nexit {status}\n")
        script.chmod(0o755)

    return program


# ---- programs


@pytest.mark.parametrize(
    ("name", "found", "cure"),
    [
        ("C compiler", "no cc", "tools/setup run"),
        ("CMake and ninja", "no cmake", "tools/setup run"),
        ("can-utils", "no candump", "tools/setup run"),
        ("target compiler", "no arm-none-eabi-gcc", "tools/setup board"),
        ("QEMU", "no qemu-system-arm", "tools/setup board"),
        ("flash tool", "none of openocd, st-flash, pyocd, dfu-util", "apt-get install openocd"),
        ("checkers", "no clang, clang-format, clang-tidy, cppcheck, shellcheck, chromium", "tools/setup test"),
    ],
)
@pytest.mark.usefixtures("plant")
def test_program_that_is_not_in_path_is_named_with_its_cure(name: str, found: str, cure: str) -> None:
    finding = examine(check(name))
    assert not finding.works
    assert (finding.found, finding.cure) == (found, cure)


@pytest.mark.parametrize(
    ("name", "program", "says", "status", "found"),
    [
        ("C compiler", "cc", "cc: internal error", 1, "cc: cc: internal error"),
        (
            "CMake and ninja",
            "cmake",
            "CMake Error: Unrecognized version",
            1,
            "cmake: CMake Error: Unrecognized version",
        ),
        ("can-utils", "candump", "error while loading shared libraries", 127, "candump does not start"),
        (
            "target compiler",
            "arm-none-eabi-gcc",
            "<stdin>:1:10: fatal error: math.h: No such file or directory",
            1,
            "arm-none-eabi-gcc: <stdin>:1:10: fatal error: math.h: No such file or directory",
        ),
        ("QEMU", "qemu-system-arm", "raspi0", 0, "qemu-system-arm knows no machine netduinoplus2"),
    ],
)
def test_program_that_is_there_but_does_not_work_is_not_believed(
    plant: Plant, name: str, program: str, says: str, status: int, found: str
) -> None:
    plant(program, says, status)
    finding = examine(check(name))
    assert not finding.works
    assert finding.found == found


def test_one_flash_tool_is_enough(plant: Plant) -> None:
    plant("st-flash", "v1.7.0")
    plant("pyocd", "broken", 1)
    assert examine(check("flash tool")) == Finding("flash tool", True, "st-flash", "flash", None)


@pytest.mark.parametrize("name", ["C compiler", "CMake and ninja", "target compiler", "QEMU", "can-utils", "checkers"])
def test_what_the_set_up_installed_works(name: str) -> None:
    finding = examine(check(name))
    assert finding.works, finding.found


# ---- Python


@pytest.mark.parametrize(
    ("needs", "found"), [("absent-package", "no Python package absent-package"), ("numpy>=99", "not >=99")]
)
def test_python_package_that_is_missing_or_too_old_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, needs: str, found: str
) -> None:
    assert examine(check("Python package")).works
    (tmp_path / "pyproject.toml").write_text(f'[project]\nversion = "1"\ndependencies = ["numpy>=1", "{needs}"]\n')
    monkeypatch.setattr(doctor, "ROOT", tmp_path)
    finding = examine(check("Python package"))
    assert finding.found.endswith(found)
    assert finding.cure == "tools/setup run"


def test_main_job_is_done_or_named_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    works = examine(check("run in-process"))
    assert works.works
    assert "301 ticks driven" in works.found
    assert main_job_works([works])

    def no_library(_library: object) -> None:
        raise OmnibotError("no firmware library")

    monkeypatch.setattr("host_sim.inproc.load_firmware", no_library)
    broken = examine(check("run in-process"))
    assert (broken.works, broken.cure) == (False, "tools/build host")
    assert not main_job_works([broken])


# ---- builds


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tree with a host build of one file."""
    build = tmp_path / "build" / "host"
    build.mkdir(parents=True)
    source = tmp_path / "source.c"
    source.touch()
    (build / "build.ninja").write_text(f"rule copy\n  command = cp $in $out\nbuild made: copy {source}\n")
    subprocess.run(["ninja", "-C", build], check=True, capture_output=True)
    monkeypatch.setattr(doctor, "ROOT", tmp_path)
    return tmp_path


def test_build_that_is_older_than_its_sources_is_found(project: Path) -> None:
    assert examine(check("host build")).works
    os.utime(project / "source.c", (4e9, 4e9))
    finding = examine(check("host build"))
    assert (finding.found, finding.cure) == ("older than its sources", "tools/build host")
    assert not examine(check("host build")).works, "to ask is not to build"


@pytest.mark.usefixtures("project")
def test_build_that_is_not_there_is_found_and_missing_ninja_is_the_cause(plant: Plant) -> None:
    assert examine(check("board build")).found == "there is no build/board"
    assert examine(check("host build")).cure == "tools/setup run"
    plant("ninja", "ninja: no work to do.")
    assert examine(check("host build")).works


# ---- the bus


def test_vcan_that_cannot_be_made_is_told_in_the_words_of_the_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for tool in ("bash", "env"):
        (tmp_path / tool).symlink_to(str(shutil.which(tool)))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(doctor, "is_can_interface", lambda _name: False)
    finding = examine(check("vcan"))
    assert not finding.works
    assert "no 'ip' command; run: apt-get install iproute2" in finding.found
    assert finding.cure == "tools/setup run"


def test_vcan0_that_is_down_is_brought_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "is_can_interface", lambda _name: True)
    monkeypatch.setattr(doctor, "VCAN_TRY", "raise OSError(100, 'Network is down')")
    finding = examine(check("vcan"))
    assert finding.found.endswith("[Errno 100] Network is down")
    assert finding.cure == "sudo ip link set vcan0 up"


def net_interface(root: Path, name: str, kind: int, flags: int) -> None:
    folder = root / "sys" / "class" / "net" / name
    folder.mkdir(parents=True)
    (folder / "type").write_text(f"{kind}\n")
    (folder / "flags").write_text(f"{flags:#x}\n")


def test_can_adapter_is_found_and_brought_up(tmp_path: Path) -> None:
    def finding() -> Finding:
        return examine(Check("", "", "plug", lambda: doctor._can_adapter(tmp_path)))

    net_interface(tmp_path, "eth0", 1, 0x1003)
    net_interface(tmp_path, "vcan0", 280, 0xC1)
    assert (finding().found, finding().cure) == ("none", "plug")
    net_interface(tmp_path, "can0", 280, 0x40080)
    assert finding().cure == "sudo ip link set can0 up type can bitrate 1000000"
    (tmp_path / "sys/class/net/can0/flags").write_text("0x400c1\n")
    assert (finding().works, finding().found) == (True, "can0")


# ---- what is plugged in


def usb_device(root: Path, place: str, vendor: str, product: str, number: int) -> None:
    folder = root / "sys" / "bus" / "usb" / "devices" / place
    folder.mkdir(parents=True)
    for name, text in (("idVendor", vendor), ("idProduct", product), ("busnum", "1"), ("devnum", str(number))):
        (folder / name).write_text(text + "\n")
    node = root / "dev" / "bus" / "usb" / "001" / f"{number:03d}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()


@pytest.mark.parametrize(
    ("vendor", "product", "name"),
    [
        ("0483", "3748", "ST-Link"),  # V2
        ("0483", "374b", "ST-Link"),  # V2-1
        ("0483", "3754", "ST-Link"),  # V3
        ("0483", "df11", "board in its USB loader (dfu-util)"),
        ("0d28", "0204", "CMSIS-DAP"),
        ("1366", "0101", "J-Link"),
    ],
)
def test_probe_on_usb_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, vendor: str, product: str, name: str
) -> None:
    usb_device(tmp_path, "usb1", "1d6b", "0002", 1)
    (tmp_path / "sys/bus/usb/devices/1-1:1.0").mkdir()
    finding = examine(Check("", "", "plug", lambda: doctor._probe(tmp_path)))
    assert (finding.found, finding.cure) == ("none on USB", "plug")

    usb_device(tmp_path, "1-1", vendor, product, 7)
    assert doctor._probe(tmp_path) == f"{name} {vendor}:{product}"

    closed = tmp_path / "dev/bus/usb/001/007"
    monkeypatch.setattr(os, "access", lambda path, _mode: Path(path) != closed)
    finding = examine(Check("", "", "plug", lambda: doctor._probe(tmp_path)))
    assert finding.found == f"{name} {vendor}:{product} may not be opened"
    assert "udev rules" in str(finding.cure)


def test_serial_port_that_may_not_be_opened_names_the_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ports: list[SimpleNamespace] = []
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    assert examine(check("serial port")).found == "none"

    port = tmp_path / "ttyACM0"
    port.touch()
    ports.append(SimpleNamespace(device=str(port)))
    assert examine(check("serial port")).found == str(port)

    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "group", lambda _: "dialout")
    monkeypatch.setenv("USER", "ada")
    members: list[str] = []
    monkeypatch.setattr("grp.getgrnam", lambda _: SimpleNamespace(gr_mem=members))
    assert examine(check("serial port")).cure == "sudo usermod --append --groups dialout ada, and log in again"
    members.append("ada")
    assert str(examine(check("serial port")).cure).startswith("newgrp dialout")


# ---- what a person reads


def test_text_names_need_and_cure_only_where_something_is_missing() -> None:
    assert (
        text_of(Finding("QEMU", True, "QEMU 7.2", "run --bus pil", None)).plain == "works   QEMU             QEMU 7.2"
    )
    missing = text_of(Finding("QEMU", False, "no qemu-system-arm", "run --bus pil", "tools/setup board")).plain
    assert missing.split("\n")[0].endswith("no qemu-system-arm; needed for run --bus pil")
    assert missing.split("\n")[1].strip() == "→ tools/setup board"


# ---- the verb


@pytest.mark.parametrize(("broken", "code"), [("QEMU", 0), ("run in-process", 1)])
def test_exit_code_tells_whether_the_main_job_works(monkeypatch: pytest.MonkeyPatch, broken: str, code: int) -> None:
    def attempt(name: str) -> str:
        if name == broken:
            raise doctor.Broken("not here")
        return "here"

    checks = [Check(name, "all", f"cure {name}", partial(attempt, name)) for name in ("run in-process", "QEMU")]
    monkeypatch.setattr("host_sim.cli.board.CHECKS", checks)
    lines = CliRunner().invoke(app, ["doctor"])
    assert lines.exit_code == code
    assert f"→ cure {broken}" in lines.stdout
    as_json = CliRunner().invoke(app, ["doctor", "--json"])
    assert as_json.exit_code == code
    result = json.loads(as_json.stdout)
    assert result["status"] == ("broken" if code else "works")
    assert {found["name"]: (found["works"], found["cure"]) for found in result["checks"]} == {
        name: (name != broken, f"cure {name}" if name == broken else None) for name in ("run in-process", "QEMU")
    }
