"""The firmware on an emulated Cortex-M4F: calls into an image, and the path that each took through its blocks.

Unicorn runs the instructions. A hook notes the address of every translated block; what a block costs is worked out
afterwards (paths.py), once for each path, for the same path costs the same. A block holds every instruction between its
first and its last, those that an IT skips included: the hardware spends a cycle on them, and so they count.
"""

from array import array
from collections.abc import Sequence
from pathlib import Path

import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

from step_cost.errors import CostError

PAGE = 0x1000
RAM_BASE, RAM_BYTES = 0x2000_0000, 0x2_0000
INSTANCE = RAM_BASE
FRAME = RAM_BASE + 0x1_8000
SCRATCH = RAM_BASE + 0x1_9000
STACK_TOP = RAM_BASE + RAM_BYTES
STACK_BYTES = 0x2000
RETURN_PAGE = 0x1000_0000  # where a call comes back to: never executed
PAINT = 0xA5
CALL_FROM_OUTSIDE = 0  # in a path
FRAME_BYTES = 11  # frame_t without its last byte of padding: id, length, data

FLOAT_REGISTERS = (arm.UC_ARM_REG_S0, arm.UC_ARM_REG_S1, arm.UC_ARM_REG_S2, arm.UC_ARM_REG_S3)
CORE_ARGUMENTS = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)


class MachineError(CostError):
    """The emulated processor could not go on."""


class Machine:
    """An ELF image in flash, RAM behind it, and one instruction stream at a time.

    Parameters
    ----------
    image
        An ELF file for the Cortex-M4F whose segments lie where the board has flash.
    traced
        Whether calls note the blocks that they run through.
    """

    def __init__(self, image: Path, traced: bool = True) -> None:
        self.path = array("I")
        self.block_bytes: dict[int, int] = {}
        self.emulator = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self.emulator.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self._load(image)
        self.emulator.mem_map(RAM_BASE, RAM_BYTES)
        self.emulator.mem_map(RETURN_PAGE, PAGE)
        if traced:
            self.emulator.hook_add(unicorn.UC_HOOK_BLOCK, self._note_block)

    def _load(self, image: Path) -> None:
        with image.open("rb") as file:
            elf = ELFFile(file)
            segments = [s for s in elf.iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"] > 0]
            for segment in segments:
                begin = segment["p_paddr"] & ~(PAGE - 1)
                end = (segment["p_paddr"] + segment["p_memsz"] + PAGE - 1) & ~(PAGE - 1)
                self.emulator.mem_map(begin, end - begin, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
                self.emulator.mem_write(segment["p_paddr"], segment.data())

    def _note_block(self, _uc: unicorn.Uc, address: int, size: int, _data: object) -> None:
        self.path.append(address)
        if address not in self.block_bytes:
            self.block_bytes[address] = size

    def call(self, function: int, *arguments: int) -> int:
        """Call a function of the image by its address and return r0."""
        uc = self.emulator
        for register, value in zip(CORE_ARGUMENTS, arguments, strict=False):
            uc.reg_write(register, value)
        uc.reg_write(arm.UC_ARM_REG_SP, STACK_TOP)
        uc.reg_write(arm.UC_ARM_REG_LR, RETURN_PAGE | 1)
        try:
            uc.emu_start(function | 1, RETURN_PAGE)
        except unicorn.UcError as error:
            pc = uc.reg_read(arm.UC_ARM_REG_PC)
            raise MachineError(f"the emulated processor stopped at {pc:#010x}: {error}") from error
        return int(uc.reg_read(arm.UC_ARM_REG_R0))

    def begin_call(self) -> None:
        """Mark in the path that a call from outside follows."""
        self.path.append(CALL_FROM_OUTSIDE)

    def call_with_floats(self, function: int, bits: Sequence[int], *arguments: int) -> None:
        """Call a function that takes floats, given by their bits, besides other arguments."""
        for register, value in zip(FLOAT_REGISTERS, bits, strict=False):
            self.emulator.reg_write(register, value)
        self.call(function, *arguments)

    def float_results(self, count: int) -> list[int]:
        """Return the bits of the floats that a function gave back."""
        return [int(self.emulator.reg_read(register)) for register in FLOAT_REGISTERS[:count]]

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of memory."""
        return bytes(self.emulator.mem_read(address, size))

    def write(self, address: int, data: bytes) -> None:
        """Change memory."""
        self.emulator.mem_write(address, data)

    def paint_stack(self) -> None:
        """Fill the stack, all of it unused between calls, with a pattern."""
        self.write(STACK_TOP - STACK_BYTES, bytes([PAINT]) * STACK_BYTES)

    def stack_used_bytes(self) -> int:
        """Return how deep the stack has gone since it was painted."""
        painted = self.read(STACK_TOP - STACK_BYTES, STACK_BYTES)
        return len(painted.lstrip(bytes([PAINT])))
