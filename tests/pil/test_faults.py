"""Processor faults in emulation: the board starts anew with its bridges off, and tells where it was.

The faults are planted into copies of the image, where the answer to PARAMETER_GET begins; all else is as it was.
"""

from pathlib import Path
from typing import NamedTuple

import pytest
from image import IMAGE_FILE, Image, assemble

from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.link import FrameRecord, Link
from host_sim.pil import EmulatedBoard

CODEC = Codec()
PLANTED_IN = "parameter_get_decode"
NOWHERE = 0x6000_0000  # no memory of this chip, nor of QEMU's


class Fault(NamedTuple):
    source: str
    pc: int | None  # behind the beginning of the function; None: where it was can't be known
    absolute: bool = False


FAULTS = {
    "read of unmapped memory": Fault(f"ldr r0, =0; movt r0, #{NOWHERE >> 16}; ldr r0, [r0]", 8),
    "write to unmapped memory": Fault(f"mov.w r0, #0; movt r0, #{NOWHERE >> 16}; str r0, [r0]; dsb; nop", 8),
    "undefined instruction": Fault("nop; udf #0", 2),
    "division by zero": Fault("movs r0, #0; udiv r0, r0, r0", 2),
    "jump into unmapped memory": Fault(f"mov.w r0, #1; movt r0, #{NOWHERE >> 16}; bx r0", NOWHERE, absolute=True),
    "stack beyond the memory": Fault("mov.w r0, #0x20000000; mov sp, r0; push {r0}", None),
}


def frames_of(frames: list[FrameRecord], name: str) -> list[dict[str, float]]:
    message = CODEC[name]
    return [message.named(data) for _, identifier, data in frames if identifier == message.arbitration_id]


def label(name: str, field: str, frames: list[FrameRecord]) -> str:
    return CODEC[name].label(field, frames_of(frames, name)[-1][field])


def tick(link: Link, number: int) -> None:
    """A tick, and what comes behind its answer."""
    link.tick(number, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    link._drain()


def test_board_without_a_crystal_says_so_and_that_it_came_from_power() -> None:
    """QEMU's clock control reads as zero: neither crystal nor PLL nor even the internal oscillator gets ready."""
    frames: list[FrameRecord] = []
    with EmulatedBoard(IMAGE_FILE) as board:
        link = Link(board, CODEC, record=frames.append)
        link.hello()
        tick(link, 0)
        assert label("HEALTH", "clock_source", frames) == "UNKNOWN"
        assert label("HEALTH", "can_state", frames) == "ABSENT"
        assert frames_of(frames, "HEALTH")[-1]["bridges"] == 0
        assert frames_of(frames, "CRASH") == []


@pytest.mark.parametrize("what", FAULTS)
def test_fault_ends_in_a_new_start_that_tells_where_it_was(what: str, tmp_path: Path) -> None:
    fault, image = FAULTS[what], Image()
    planted = image.patched(tmp_path / "planted.elf", PLANTED_IN, assemble(fault.source, tmp_path))
    frames: list[FrameRecord] = []
    with EmulatedBoard(planted) as board:
        link = Link(board, CODEC, timeout_s=10.0, record=frames.append)
        link.hello()
        tick(link, 0)
        assert frames_of(frames, "CRASH") == []

        link.send("PARAMETER_GET", 0, 0, 0)
        board._wait_for_firmware()  # it has closed its channel, as out of any reset
        del frames[:]
        link.hello()
        assert CODEC["STATUS"].label("mode", link.status["mode"]) == "IDLE"
        tick(link, 0)
        assert label("HEALTH", "reset_cause", frames) == "CRASH"
        assert frames_of(frames, "HEALTH")[-1]["bridges"] == 0
        (crash,) = frames_of(frames, "CRASH")
        if fault.pc is None:
            assert crash["pc"] == 0
        else:
            assert hex(int(crash["pc"])) == hex(fault.pc + (0 if fault.absolute else image.address[PLANTED_IN]))
            assert crash["lr"] % 2 == 1
            assert 0x0800_0000 < crash["lr"] < 0x0800_0000 + (1 << 20)

        tick(link, 100)
        assert len(frames_of(frames, "CRASH")) == 1  # told once


def test_fault_is_forgotten_by_the_run_after_the_next(tmp_path: Path) -> None:
    image = Image()
    planted = image.patched(tmp_path / "planted.elf", PLANTED_IN, assemble("udf #0", tmp_path))
    with EmulatedBoard(planted) as board:
        link = Link(board, CODEC, timeout_s=10.0)
        link.hello()
        for _ in range(2):  # each crash is one of its own
            link.send("PARAMETER_GET", 0, 0, 0)
            with pytest.raises(OmnibotError, match="no PARAMETER_VALUE"):
                link.wait_for("PARAMETER_VALUE", 0.2)
            board._wait_for_firmware()
            frames: list[FrameRecord] = []
            link = Link(board, CODEC, timeout_s=10.0, record=frames.append)
            link.hello()
            tick(link, 0)
            (crash,) = frames_of(frames, "CRASH")
            assert crash["pc"] == image.address[PLANTED_IN]
