"""The instruction counter against QEMU's -icount: the same image, frames through the firmware, on both."""

import subprocess
from pathlib import Path

import pytest
from step_cost.corpus import ORDERS, Session, sessions
from step_cost.image import Image
from step_cost.machine import Machine
from step_cost.paths import Blocks

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
BUILD = ROOT / "build" / "target"
CPU = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
INCLUDES = [
    f"-I{folder}"
    for folder in (ROOT / "firmware/app", ROOT / "firmware/control", ROOT / "protocol", BUILD / "generated")
]
SYSTICK_NS = 1000.0 / 168.0  # QEMU's netduinoplus2 runs its SysTick at 168 MHz


def written_in_c(session: Session) -> str:
    frames = [frame for group in session.groups for frame in group.frames]
    rows = [f"{{{frame.identifier}, {len(frame.data)}, {{{', '.join(map(str, frame.data))}}}}}," for frame in frames]
    head = f'#include "frame.h"\nenum {{ FRAME_COUNT = {len(rows)} }};\nstatic const frame_t frames[FRAME_COUNT] = {{'
    return "\n".join([head, *rows, "};", ""])


def session_named(beginning: str, order: str) -> Session:
    return next(session for session in sessions((order,)) if session.name.startswith(beginning))


def built(folder: Path, session: Session) -> Path:
    (folder / "frames.h").write_text(written_in_c(session))
    archives = [str(BUILD / f"lib{name}.a") for name in ("app", "control", "protocol")]
    image = folder / "icount.elf"
    sources = [str(HERE / "icount.c"), f"-I{folder}", *INCLUDES]
    link = ["-nostartfiles", "--specs=nano.specs", "-T", str(HERE / "icount.ld"), *archives, "-o", str(image)]
    subprocess.run(
        ["arm-none-eabi-gcc", *CPU, "-std=gnu11", "-O2", "-g", "-Wall", "-Werror", *sources, *link], check=True
    )
    return image


def ticks_by_qemu(image: Path) -> list[int]:
    """SysTick counts of one run of the workload and of three."""
    command = ["qemu-system-arm", "-M", "netduinoplus2", "-nodefaults", "-display", "none", "-serial", "none"]
    command += ["-monitor", "none", "-icount", "shift=0,sleep=off", "-semihosting-config", "enable=on,target=native"]
    done = subprocess.run([*command, "-kernel", str(image)], capture_output=True, text=True, timeout=60, check=False)
    words = (done.stdout + done.stderr).split()
    assert len(words) == 2, done
    return [int(word, 16) for word in words]


def instructions_by_unicorn(image: Path) -> int:
    machine, elf = Machine(image), Image(image)
    machine.begin_call()
    machine.call(elf.function("workload"))
    return Blocks(elf, machine.block_bytes).cost(machine.path.tobytes()).total.instructions


@pytest.mark.parametrize("beginning", ["rounded", "random 1", "faults"])
def test_counter_agrees_with_qemu_icount(beginning: str, tmp_path: Path) -> None:
    image = built(tmp_path, session_named(beginning, ORDERS[-1]))
    once, thrice = ticks_by_qemu(image)
    # What is around the workload goes out of the difference; the loop takes a few instructions a turn.
    by_qemu = (thrice - once) * SYSTICK_NS / 2.0
    counted = instructions_by_unicorn(image)
    assert counted > 50_000
    assert by_qemu == pytest.approx(counted, abs=SYSTICK_NS + 8)
