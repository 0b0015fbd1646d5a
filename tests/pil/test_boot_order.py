"""The order of register writes out of a reset and out of a fault: the image's own instructions under Unicorn.

The registers are a model: memory that keeps what is written, with the ready bits that real hardware would raise. The
addresses are RM0090's, not the firmware's header's.
"""

from collections.abc import Callable
from typing import NamedTuple

import pytest
from image import Image
from unicorn import UC_ARCH_ARM, UC_HOOK_BLOCK, UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_SP, UC_CPU_ARM_CORTEX_M4

FLASH, FLASH_BYTES = 0x0800_0000, 1 << 20
RAM, RAM_BYTES = 0x2000_0000, 128 << 10
PERIPHERALS, PERIPHERAL_BYTES = 0x4000_0000, 0x0008_0000
CORE, CORE_BYTES = 0xE000_0000, 0x0010_0000

RCC = 0x4002_3800
RCC_CR, RCC_CFGR, RCC_AHB1ENR, RCC_CSR = RCC, RCC + 0x08, RCC + 0x30, RCC + 0x74
RCC_AHB1ENR_GPIOB = 1 << 1
GPIOB = 0x4002_0400
GPIOB_MODER, GPIOB_ODR, GPIOB_BSRR = GPIOB, GPIOB + 0x14, GPIOB + 0x18
TIM8 = 0x4001_0400
TIM8_CCR = tuple(TIM8 + 0x34 + 4 * channel for channel in range(3))
IWDG_KR, IWDG_START = 0x4000_3000, 0xCCCC
CPACR, AIRCR = 0xE000_ED88, 0xE000_ED0C
SYSRESETREQ = 0x05FA_0004

BRIDGE_ENABLE = 15  # of port B
INSTRUCTIONS = 2_000_000

# Bits of RCC_CSR after each kind of reset (RM0090 7.3.21).
RESETS = {"power-on": 0x0E00_0000, "reset pin": 0x0400_0000, "watchdog": 0x2400_0000, "software": 0x1400_0000}


class Write(NamedTuple):
    address: int
    value: int

    @property
    def is_peripheral(self) -> bool:
        return self.address >= PERIPHERALS


class Board:
    """The image in a processor with a register model; ``writes`` keeps every write in order."""

    def __init__(self, *, crystal: bool = True, ready: bool = True, reset_flags: int = RESETS["power-on"]) -> None:
        self.image = Image()
        self.writes: list[Write] = []
        self.crystal = crystal
        uc = self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M4)
        regions = ((FLASH, FLASH_BYTES), (RAM, RAM_BYTES), (PERIPHERALS, PERIPHERAL_BYTES), (CORE, CORE_BYTES))
        for start, size in regions:
            uc.mem_map(start, size)
        for address, _, data in self.image.segments:
            uc.mem_write(address, data)
        uc.mem_write(RAM, b"\xa5" * RAM_BYTES)  # what memory comes up with
        self.poke(RCC_CR, 0x83)  # the internal oscillator is on and ready
        self.poke(RCC_CSR, reset_flags)
        uc.hook_add(UC_HOOK_MEM_WRITE, self._note)
        if ready:
            uc.hook_add(UC_HOOK_MEM_READ, self._raise_ready_bits, begin=RCC, end=RCC + 0x80)
        self._stop_at: int | None = None
        self._arrived = False
        uc.hook_add(UC_HOOK_BLOCK, self._stop_there)

    def poke(self, address: int, value: int) -> None:
        self.uc.mem_write(address, value.to_bytes(4, "little"))

    def peek(self, address: int) -> int:
        return int.from_bytes(self.uc.mem_read(address, 4), "little")

    def _note(self, _uc: Uc, _access: int, address: int, _size: int, value: int, _data: object) -> None:
        self.writes.append(Write(address, value & 0xFFFF_FFFF))

    def _raise_ready_bits(self, _uc: Uc, _access: int, address: int, _size: int, _value: int, _data: object) -> None:
        if address == RCC_CR:  # HSEON 16 → HSERDY 17, PLLON 24 → PLLRDY 25
            cr = self.peek(RCC_CR) & ~(1 << 17 | 1 << 25)
            cr |= (cr & 1 << 16) << 1 if self.crystal else 0
            self.poke(RCC_CR, cr | (cr & 1 << 24) << 1)
        if address == RCC_CFGR:  # SW → SWS
            cfgr = self.peek(RCC_CFGR)
            self.poke(RCC_CFGR, cfgr & ~0xC | (cfgr & 3) << 2)

    def _stop_there(self, uc: Uc, address: int, _size: int, _data: object) -> None:
        if address == self._stop_at:
            self._arrived = True
            uc.emu_stop()

    def run(self, start: int, stop_at: int) -> None:
        """Run from a vector to the beginning of a function."""
        self._stop_at = stop_at
        self.uc.emu_start(start | 1, 0, count=INSTRUCTIONS)
        assert self._arrived

    def reset(self, stop_at: str) -> list[Write]:
        """Run from the reset vector to the beginning of a function."""
        self.uc.reg_write(UC_ARM_REG_SP, self.image.word(FLASH))
        self.run(self.image.word(FLASH + 4), self.image.address[stop_at])
        return self.writes


def is_bridge_off(write: Write) -> bool:
    """The enable line driven low, by its set-and-reset register or as a whole."""
    low = write.address == GPIOB_BSRR and write.value & 1 << BRIDGE_ENABLE + 16 and not write.value & 1 << BRIDGE_ENABLE
    return bool(low) or (write.address == GPIOB_ODR and not write.value & 1 << BRIDGE_ENABLE)


def is_bridge_on(write: Write) -> bool:
    return (write.address == GPIOB_BSRR and bool(write.value & 1 << BRIDGE_ENABLE)) or (
        write.address == GPIOB_ODR and bool(write.value & 1 << BRIDGE_ENABLE)
    )


def outside_the_stack(writes: list[Write], board: Board) -> list[Write]:
    stack = range(board.image.address["stack_bottom"], board.image.address["stack_top"])
    return [write for write in writes if write.address not in stack]


def assert_bridges_go_off_first(writes: list[Write]) -> None:
    """Nothing but port B, and its clock, is touched before the enable line is a low output."""
    driven = next(index for index, write in enumerate(writes) if is_output(write))
    first = writes[: driven + 1]
    assert any(is_bridge_off(write) for write in first), first
    assert {write.address for write in first} <= {RCC_AHB1ENR, *range(GPIOB, GPIOB + 0x28)}
    assert first[0].address == RCC_AHB1ENR  # a port without a clock takes nothing
    assert first[0].value & RCC_AHB1ENR_GPIOB
    off = next(index for index, write in enumerate(first) if is_bridge_off(write))
    assert off < driven  # low before it is an output


def is_output(write: Write) -> bool:
    return write.address == GPIOB_MODER and write.value >> 2 * BRIDGE_ENABLE & 3 == 1


def assert_line_is_low(board: Board) -> None:
    assert board.peek(GPIOB_MODER) >> 2 * BRIDGE_ENABLE & 3 == 1
    levels = [is_bridge_on(write) for write in board.writes if is_bridge_on(write) or is_bridge_off(write)]
    assert levels
    assert not any(levels)


# ---- out of a reset


@pytest.mark.parametrize("crystal", [True, False], ids=["crystal", "no crystal"])
@pytest.mark.parametrize("reset", RESETS)
def test_bridges_go_off_before_anything_else_out_of_any_reset(reset: str, crystal: bool) -> None:
    board = Board(crystal=crystal, reset_flags=RESETS[reset])
    writes = board.reset(stop_at="loop_turn")
    assert_bridges_go_off_first(outside_the_stack(writes, board))


@pytest.mark.parametrize("crystal", [True, False], ids=["crystal", "no crystal"])
def test_bridges_stay_off_until_the_first_turn_of_the_loop(crystal: bool) -> None:
    board = Board(crystal=crystal)
    writes = board.reset(stop_at="loop_turn")
    assert len(writes) > 1000  # it went all the way: memory was cleared, everything set up
    assert_line_is_low(board)
    assert {write.value for write in writes if write.address in TIM8_CCR} <= {0}


def test_floating_point_is_on_before_memory_is_touched() -> None:
    board = Board()
    writes = outside_the_stack(board.reset(stop_at="main"), board)
    order = [write.address for write in writes]
    assert order.index(CPACR) < next(index for index, write in enumerate(writes) if not write.is_peripheral)
    assert board.peek(CPACR) >> 20 & 0xF == 0xF


def test_watchdog_starts_once_and_last_of_all_peripherals() -> None:
    board = Board()
    writes = [write for write in board.reset(stop_at="loop_turn") if write.is_peripheral]
    starts = [index for index, write in enumerate(writes) if write == Write(IWDG_KR, IWDG_START)]
    assert len(starts) == 1
    later = {write.address for write in writes[starts[0] :]}
    assert all(IWDG_KR <= address < IWDG_KR + 0x10 for address in later), [hex(address) for address in later]


def test_start_ends_though_nothing_ever_gets_ready() -> None:
    board = Board(ready=False)
    board.reset(stop_at="loop_turn")
    assert_line_is_low(board)
    assert board.peek(RCC_CFGR) & 3 == 0  # still on the internal oscillator


# ---- out of a fault

FAULTS = {2: "NMI", 3: "HardFault", 4: "MemManage", 5: "BusFault", 6: "UsageFault"}


def stacked(board: Board) -> int:
    return board.image.address["stack_top"] - 0x40


STACKS: dict[str, Callable[[Board], int]] = {
    "good": stacked,
    "below the memory": lambda _: RAM - 0x100,
    "beyond the memory": lambda _: RAM + RAM_BYTES,
}


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("exception", FAULTS, ids=FAULTS.values())
def test_bridges_go_off_before_anything_else_out_of_any_fault(exception: int, stack: str) -> None:
    board = Board()
    board.uc.reg_write(UC_ARM_REG_SP, STACKS[stack](board))
    board.uc.reg_write(UC_ARM_REG_LR, 0xFFFF_FFF9)  # of an exception out of thread mode, main stack
    # It drives: the line is high.
    board.poke(GPIOB_MODER, 1 << 2 * BRIDGE_ENABLE)
    board.poke(GPIOB_ODR, 1 << BRIDGE_ENABLE)
    board.run(board.image.word(FLASH + 4 * exception), board.image.address["board_reset"])
    writes = [write for write in board.writes if write.is_peripheral]
    assert_bridges_go_off_first(writes)
    assert_line_is_low(board)


@pytest.mark.parametrize("exception", FAULTS, ids=FAULTS.values())
def test_fault_ends_in_a_request_for_reset(exception: int) -> None:
    board = Board()
    board.uc.reg_write(UC_ARM_REG_SP, stacked(board))
    board.uc.reg_write(UC_ARM_REG_LR, 0xFFFF_FFF9)
    board.uc.emu_start(board.image.word(FLASH + 4 * exception) | 1, 0, count=20_000)
    assert Write(AIRCR, SYSRESETREQ) in board.writes
    assert board.writes.index(Write(AIRCR, SYSRESETREQ)) > next(
        index for index, write in enumerate(board.writes) if is_bridge_off(write)
    )
