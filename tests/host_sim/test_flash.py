"""omnibot flash against scripts that behave as the tools do: what they are given, and what becomes of what they say.

The messages are the tools' own: those of a missing probe were seen, the others stand in the tools' sources.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from host_sim import flash as module
from host_sim.cli import app
from host_sim.errors import OmnibotError
from host_sim.flash import RUNNERS, flash

AT = "0x08000000"
IMAGE = struct.pack("<II", 0x2000_2000, 0x0800_0009) + bytes(range(200))

Fake = Callable[..., Path]


@pytest.fixture
def image(tmp_path: Path) -> Path:
    file = tmp_path / "an image.bin"
    file.write_bytes(IMAGE)
    return file


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Put a script of a tool's name into an otherwise empty PATH; it records its arguments, a line each."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))

    def make(name: str, says: str = "", status: int = 0, does: str = "") -> Path:
        record = tmp_path / f"{name}.arguments"
        script = folder / name
        script.write_text(
            f"#!/bin/sh\nprintf '%s\\n' \"$@\" END >>'{record}'\n{does}\n"
            f"/bin/cat <<'SAID'\n{says}\nSAID\nexit {status}\n"
        )
        script.chmod(0o755)
        return record

    return make


def calls(record: Path) -> list[list[str]]:
    return [call.splitlines() for call in record.read_text().split("END\n")[:-1]]


def flash_with(name: str | None, image: Path) -> list[str]:
    said: list[str] = []
    flash(name, image, dry_run=False, say=said.append)
    return said


def refused(name: str | None, image: Path) -> str:
    with pytest.raises(OmnibotError) as error:
        flash_with(name, image)
    assert "\n" not in str(error.value)
    return str(error.value)


# ---- what the tools are given


def test_openocd_programs_verifies_and_resets(fake: Fake, image: Path) -> None:
    record = fake(
        "openocd", "** Programming Finished **\n** Verify Started **\n** Verified OK **\n** Resetting Target **"
    )
    flash_with("openocd", image)
    program = f"program {{{image}}} {AT} verify reset exit"
    assert calls(record) == [["-f", "interface/stlink.cfg", "-f", "target/stm32f4x.cfg", "-c", program]]


def test_st_flash_writes_which_verifies_and_resets(fake: Fake, image: Path) -> None:
    record = fake("st-flash", "INFO common.c: Flash written and verified! jolly good!")
    flash_with("st-flash", image)
    assert calls(record) == [["--reset", "write", str(image), AT]]


def test_pyocd_loads_compares_and_resets(fake: Fake, image: Path) -> None:
    record = fake("pyocd", "All 208 bytes match.")
    flash_with("pyocd", image)
    board = ["--no-wait", "--target", "stm32f405rg"]
    assert calls(record) == [
        ["load", *board, "--erase", "sector", "--base-address", AT, str(image)],
        ["commander", *board, "--command", f"compare {AT} '{image}'", "--command", "reset"],
    ]


UPLOAD = 'for file; do :; done; case "$*" in *--upload*) /bin/cp {source} "$file" ;; esac'


def test_dfu_util_writes_reads_back_and_leaves_the_loader(fake: Fake, image: Path) -> None:
    record = fake("dfu-util", "Download done.", does=UPLOAD.format(source=f"'{image}'"))
    flash_with("dfu-util", image)
    device = ["--device", "0483:df11", "--alt", "0", "--dfuse-address"]
    write, read = calls(record)
    assert write == [*device, AT, "--download", str(image)]
    assert read[:-1] == [*device, f"{AT}:{len(IMAGE)}:leave", "--upload"]
    assert not Path(read[-1]).exists()  # it was ours, and is gone


def test_commands_and_what_they_say_are_passed_on(fake: Fake, image: Path) -> None:
    fake("st-flash", "st-flash 1.7.0\nFlash written and verified! jolly good!")
    said = flash_with("st-flash", image)
    assert said == [
        f"st-flash --reset write '{image}' {AT}",
        "st-flash 1.7.0",
        "Flash written and verified! jolly good!",
    ]


def test_dry_run_shows_every_command_and_runs_none(fake: Fake, image: Path) -> None:
    for runner in RUNNERS:
        record = fake(runner.program)
        said: list[str] = []
        flash(runner.program, image, dry_run=True, say=said.append)
        assert [line.split()[0] for line in said] == [runner.program] * len(said)
        assert said
        assert not record.exists()


# ---- which tool


def test_first_tool_that_is_installed_is_taken(fake: Fake, image: Path) -> None:
    fake("dfu-util", does=UPLOAD.format(source=f"'{image}'"))
    assert flash_with(None, image)[0].startswith("dfu-util ")
    fake("openocd", "** Verified OK **")
    assert flash_with(None, image)[0].startswith("openocd ")


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("openocd", "apt-get install openocd"),
        ("st-flash", "apt-get install stlink-tools"),
        ("dfu-util", "apt-get install dfu-util"),
        ("pyocd", ".venv/bin/pip install pyocd"),
    ],
)
def test_missing_tool_is_named_with_what_installs_it(image: Path, name: str, cure: str) -> None:
    assert refused(name, image) == f"no {name} in PATH: {cure}"


@pytest.mark.usefixtures("fake")
def test_no_tool_at_all_names_them_and_installs_one(image: Path) -> None:
    tools = "openocd, st-flash, pyocd, dfu-util"
    assert refused(None, image) == f"no tool to flash with, none of {tools}: apt-get install openocd"


def test_unknown_tool_is_refused(image: Path) -> None:
    assert refused("jlink", image) == "--runner jlink: must be one of openocd, st-flash, pyocd, dfu-util"


# ---- what they complain of

COMPLAINTS = [
    ("openocd", 1, "Error: open failed\nin procedure 'program'\n** OpenOCD init failed **", "no debug probe"),
    ("openocd", 1, "Error: libusb_open() failed with LIBUSB_ERROR_ACCESS\nError: open failed", "may not be opened"),
    ("openocd", 1, "Warn : target voltage may be too low for reliable debugging", "is not powered"),
    ("openocd", 1, "Error: init mode failed (unable to connect to the target)", "does not reach the board"),
    ("openocd", 1, "** Verify Failed **", "is not the image"),
    ("st-flash", 255, "2026 WARN usb.c: Couldn't find any ST-Link devices", "no debug probe"),
    ("st-flash", 255, "WARN usb.c: Could not open USB device 0x0483:0x3748, access error.", "may not be opened"),
    ("st-flash", 255, "Stlink usb device found, but unable to claim (probably already in use?)", "another program"),
    ("st-flash", 255, "Failed to connect to target", "does not reach the board"),
    ("st-flash", 255, "ERROR common.c: Target voltage (1 mV) too low for flash writes!", "is not powered"),
    ("st-flash", 255, "Verification of flash failed at offset: 4", "is not the image"),
    ("dfu-util", 74, "dfu-util: No DFU capable USB device available", "hold BOOT0 high, reset"),
    ("dfu-util", 74, "Cannot open DFU device 0483:df11 found on devnum 5 (LIBUSB_ERROR_ACCESS)", "may not be opened"),
    ("pyocd", 1, "No connected debug probes\nE No target device available [load_cmd]", "no debug probe"),
    (
        "pyocd",
        1,
        "C Target type stm32f405rg not recognized. Use 'pyocd list --targets'",
        "pyocd pack install stm32f405rg",
    ),
    ("pyocd", 1, "SWD/JTAG communication failure (No ACK)", "does not reach the board"),
    ("pyocd", 0, "Mismatched byte at 0x08000004 (offset 0x4): 0xff (memory) != 0x09 (file)", "is not the image"),
]


@pytest.mark.parametrize(("name", "status", "says", "expected"), COMPLAINTS)
def test_known_complaint_is_answered_with_its_cure(
    fake: Fake, image: Path, name: str, status: int, says: str, expected: str
) -> None:
    fake(name, says, status)
    message = refused(name, image)
    assert message.startswith(f"{name}: ")
    assert expected in message


@pytest.mark.parametrize("name", [runner.program for runner in RUNNERS])
def test_unknown_complaint_names_the_status(fake: Fake, image: Path, name: str) -> None:
    fake(name, "the sky is falling", 3)
    assert refused(name, image) == f"{name} ended with status 3; its messages are above"


@pytest.mark.parametrize("name", ["openocd", "st-flash", "pyocd"])
def test_tool_that_ends_well_without_a_word_of_success_is_not_believed(fake: Fake, image: Path, name: str) -> None:
    fake(name, "done")
    assert "does not say that the board holds the image" in refused(name, image)


def test_what_dfu_util_reads_back_is_compared(fake: Fake, image: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(IMAGE[:-1] + b"\0")
    for source in (other, Path("/dev/null")):
        fake("dfu-util", does=UPLOAD.format(source=source))
        assert "is not the image" in refused("dfu-util", image)
    fake("dfu-util")  # nothing is read back
    assert "is not the image" in refused("dfu-util", image)


# ---- the image


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "empty"),
        (b"\x7fELF\x01\x01\x01\x00", "an ELF file"),
        (struct.pack("<II", 0x2000_0000, 0x0800_0009) + bytes(100), "stack at the RAM's beginning"),
        (struct.pack("<II", 0x2002_0004, 0x0800_0009) + bytes(100), "stack beyond the RAM"),
        (struct.pack("<II", 0x2000_2000, 0x0800_0008) + bytes(100), "reset address without the Thumb bit"),
        (struct.pack("<II", 0x2000_2000, 0x0800_0071) + bytes(100), "reset address behind the image"),
        (struct.pack("<II", 0x2000_2000, 0x0800_0009) + bytes(0xC0000), "reaches the parameters that are kept"),
    ],
)
def test_file_that_is_no_image_is_refused_before_a_tool_runs(
    fake: Fake, tmp_path: Path, content: bytes, why: str
) -> None:
    record = fake("openocd", "** Verified OK **")
    file = tmp_path / "other.bin"
    file.write_bytes(content)
    assert "is no image of the STM32F405's flash" in refused("openocd", file), why
    assert not record.exists()


def test_missing_image_is_named_with_its_cure(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake("openocd")
    assert refused(None, tmp_path / "none.bin").endswith("(No such file or directory): give the board's omnibot.bin")
    monkeypatch.setattr(module, "IMAGE_FILE", tmp_path / "omnibot.bin")
    assert refused(None, tmp_path / "omnibot.bin").endswith("(No such file or directory): tools/build board makes it")


# ---- the command line


def test_verb_flashes_and_says_so(fake: Fake, image: Path) -> None:
    fake("openocd", "** Verified OK **")
    result = CliRunner().invoke(app, ["flash", "--image", str(image)])
    assert result.exit_code == 0
    assert result.stdout.endswith(f"** Verified OK **\nflashed and verified: {image}\n")


def test_verb_with_dry_run_claims_nothing(fake: Fake, image: Path) -> None:
    fake("openocd")
    result = CliRunner().invoke(app, ["flash", "--dry-run", "--image", str(image)])
    assert result.exit_code == 0
    assert result.stdout.startswith("openocd ")
    assert result.stdout.count("\n") == 1
