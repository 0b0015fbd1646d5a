"""What an instruction costs on the Cortex-M4 with its FPU: a model, and so an estimate.

Source: the Cortex-M4 Technical Reference Manual (ARM DDI 0439, newer ARM 100166): table 3-1 'Processor instruction set
summary', the section 'Load/store timings' behind it, table 7-1 'FPU instruction set' and its notes; all for memory
without wait states. Where the manual gives a range or a 'when possible', three models say what is made of it: `LOW`
takes every chance, `HIGH` none, and `CENTRAL`, the one that budgets hold, lies between. GCC's description of the
pipeline (cortex-m4.md, cortex-m4-fpu.md) reads the manual as `CENTRAL` does, but for FPU stores and divisions, where it
is `LOW`.

- A taken branch refills the pipeline in P = 1 … 3 cycles (3-1): 1, 2 and 3 in the three models.
- A load right behind a load is pipelined, one cycle instead of two, unless its address waits for the first. `HIGH`
  leaves that out for the FPU's loads, which the section does not name.
- A load from beside the code 'might add a cycle': in `HIGH` it does.
- A store to [register, #immediate] takes one cycle, others two. The FPU's take two by table 7-1: `HIGH` counts so,
  `CENTRAL` pipelines them behind a load or store, `LOW` takes them for stores like any other.
- An address that waits for the data-processing instruction right before costs one more cycle.
- TBB and TBH: two for the load, one for the addition, and the refill.
- The result of an FPU arithmetic instruction costs one more cycle when the next instruction uses it; the addend of a
  multiply-accumulate is read a cycle later, and so costs none (7-1).
- VDIV and VSQRT take 14. Integer instructions behind them may run meanwhile: only `LOW` counts on that.
- SDIV and UDIV end early, 2 … 12 (3-1): `LOW` takes 2, the others 12.
- IT takes one cycle, and may be folded into the instruction before (3-1): `LOW` folds it.
- What an IT skips is charged as if it were executed.
"""

from dataclasses import dataclass
from typing import NamedTuple

import capstone
from capstone import arm as ca

from step_cost.errors import CostError


@dataclass(frozen=True)
class Model:
    """How the chances of the manual are taken."""

    name: str
    refill: int
    fpu_loads_pipelined: bool
    fpu_store_alone: int
    fpu_store_behind_access: int
    divide: int
    it: int
    literal_wait: int
    integer_beside_fpu_divide: bool


LOW = Model("low", 1, True, 1, 1, 2, 0, 0, True)
CENTRAL = Model("central", 2, True, 2, 1, 12, 1, 0, False)
HIGH = Model("high", 3, False, 2, 2, 12, 1, 1, False)
MODELS = (LOW, CENTRAL, HIGH)


def _names_of(text: str) -> frozenset[str]:
    return frozenset(text.split())


FPU_ARITHMETIC = _names_of("vadd vsub vmul vnmul vdiv vsqrt vcvt vcvtr vmla vmls vnmla vnmls vfma vfms vfnma vfnms")
MULTIPLY_ACCUMULATE = _names_of("vmla vmls vnmla vnmls vfma vfms vfnma vfnms")
FPU_ONE_CYCLE = _names_of("vadd vsub vmul vnmul vcvt vcvtr vabs vneg vcmp vcmpe vmrs vmsr")
LOADS = _names_of("ldr ldrb ldrh ldrsb ldrsh")
STORES = _names_of("str strb strh")
MULTIPLE = _names_of("ldm ldmdb stm stmdb push pop ldrd strd vldmia vldmdb vstmia vstmdb vpush vpop")
BRANCHES = _names_of("b bl blx bx cbz cbnz tbb tbh")
DIVIDES = _names_of("sdiv udiv")
# One cycle each by table 3-1; anything that is in no list is refused, not guessed.
INTEGER = _names_of(
    """mov movw movt mvn add addw adc adr sub subw sbc rsb mul mla mls smull umull smlal umlal cmp cmn and eor orr orn
    bic tst teq lsl lsr asr ror rrx rev rev16 revsh rbit clz ubfx sbfx bfi bfc uxtb uxth sxtb sxth uxtab uxtah sxtab
    sxtah ssat usat umaal smlabb smlabt smlatb smlatt smulbb smulbt smultb smultt smmul smmla nop uadd8 sel"""
)


class UnknownInstructionError(CostError):
    """An instruction that the model has no figure for."""


class Instruction(NamedTuple):
    """What the model has to know of one instruction; registers by name, the FPU's as singles."""

    address: int
    size: int
    text: str
    name: str  # mnemonic without condition, width and data type
    kind: str  # as the profile sorts them
    conditional: bool
    reads: frozenset[str]
    writes: frozenset[str]
    address_reads: frozenset[str]  # registers that make an address
    addend: frozenset[str]  # of a multiply-accumulate
    register_offset: bool
    units: int  # words of a multiple transfer
    branches: bool  # may go elsewhere than to the next instruction

    @property
    def end(self) -> int:
        """Address behind it."""
        return self.address + self.size

    @property
    def calls(self) -> bool:
        """It leaves its own end in the link register."""
        return self.name in ("bl", "blx")


# ---- reading instructions


def _singles(register: str) -> list[str]:
    """Return an FPU register as its singles, any other as itself."""
    if register[0] == "d" and register[1:].isdigit():
        number = 2 * int(register[1:])
        return [f"s{number}", f"s{number + 1}"]
    return [register]


def _names(instruction: capstone.CsInsn, registers: list[int]) -> frozenset[str]:
    return frozenset(name for register in registers for name in _singles(instruction.reg_name(register)))


def _plain_name(instruction: capstone.CsInsn) -> str:
    """Return the mnemonic without its condition, width, data type and the S of 'sets flags'."""
    name = str(instruction.mnemonic).partition(".")[0]
    known = INTEGER | LOADS | STORES | MULTIPLE | BRANCHES | DIVIDES | FPU_ARITHMETIC | FPU_ONE_CYCLE
    known |= {"vmov", "vldr", "vstr", "vfp"}
    if name.startswith("it") and set(name[1:]) <= {"t", "e"}:
        return "it"
    for candidate in (name, name[:-2], name[:-1], name[:-3]):
        if candidate in known:
            return candidate
    raise UnknownInstructionError(
        f"no cycles known for '{instruction.mnemonic} {instruction.op_str}' at {instruction.address:#010x}: "
        "add it to tools/step_cost/cycles.py with its source"
    )


def _kind(name: str, is_pc_written: bool) -> str:
    if name in BRANCHES or is_pc_written:
        return "branch"
    if name in ("vdiv", "vsqrt"):
        return "FPU divide, root"
    if name in FPU_ARITHMETIC:
        return "FPU arithmetic"
    if name.startswith("v") and name in FPU_ONE_CYCLE | {"vmov"}:
        return "FPU move, compare"
    if name in LOADS or name == "vldr":
        return "load"
    if name in STORES or name == "vstr":
        return "store"
    return "multiple load, store" if name in MULTIPLE else "integer"


def _memory(instruction: capstone.CsInsn) -> tuple[frozenset[str], bool]:
    """Return the registers of a memory operand, and whether one is an offset."""
    for operand in instruction.operands:
        if operand.type == ca.ARM_OP_MEM:
            registers = [r for r in (operand.mem.base, operand.mem.index) if r]
            return _names(instruction, registers), bool(operand.mem.index)
    return frozenset(), False


def _units(instruction: capstone.CsInsn, name: str) -> int:
    """Return how many words a multiple transfer moves."""
    if name in ("ldrd", "strd"):
        return 2
    registers = [o.reg for o in instruction.operands if o.type == ca.ARM_OP_REG]
    if name not in ("push", "pop", "vpush", "vpop"):
        registers = registers[1:]  # the base
    return sum(len(_singles(instruction.reg_name(register))) for register in registers)


def read_instruction(instruction: capstone.CsInsn) -> Instruction:
    """Take out of capstone's account what the model looks at."""
    name = _plain_name(instruction)
    reads, writes = (_names(instruction, list(part)) for part in instruction.regs_access())
    address_reads, register_offset = _memory(instruction)
    is_pc_written = "pc" in writes
    destination = [o.reg for o in instruction.operands[:1] if o.type == ca.ARM_OP_REG]
    accumulates = name in MULTIPLY_ACCUMULATE
    return Instruction(
        address=instruction.address,
        size=instruction.size,
        text=f"{instruction.mnemonic} {instruction.op_str}".strip(),
        name=name,
        kind=_kind(name, is_pc_written),
        conditional=instruction.cc not in (ca.ARM_CC_AL, ca.ARM_CC_INVALID) or name in ("cbz", "cbnz"),
        reads=reads | (_names(instruction, destination) if accumulates else frozenset()),
        writes=writes,
        address_reads=address_reads,
        addend=_names(instruction, destination) if accumulates else frozenset(),
        register_offset=register_offset,
        units=_units(instruction, name) if name in MULTIPLE else 1,
        branches=name in BRANCHES or is_pc_written,
    )


class Decoder:
    """Instructions out of bytes of Thumb code."""

    def __init__(self) -> None:
        self._capstone = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
        self._capstone.detail = True

    def decode(self, code: bytes, address: int) -> list[Instruction]:
        """Return every instruction of a block; refuses bytes that are none."""
        decoded = [read_instruction(instruction) for instruction in self._capstone.disasm(code, address)]
        if sum(instruction.size for instruction in decoded) != len(code):
            raise UnknownInstructionError(f"no instruction behind {len(decoded)} others at {address:#010x}")
        return decoded


# ---- the model


def _is_access(instruction: Instruction | None) -> bool:
    return instruction is not None and instruction.kind in ("load", "store")


def _is_double(instruction: Instruction) -> bool:
    """Tell whether VLDR or VSTR moves a double register."""
    return " d" in instruction.text


def _load(model: Model, instruction: Instruction, before: Instruction | None) -> int:
    if _is_double(instruction):
        return 3
    pipelines = instruction.name != "vldr" or model.fpu_loads_pipelined
    follows = before is not None and before.kind == "load" and not before.writes & instruction.address_reads
    literal = model.literal_wait if "pc" in instruction.address_reads else 0
    return (1 if pipelines and follows else 2) + literal


def _store(model: Model, instruction: Instruction, before: Instruction | None) -> int:
    if _is_double(instruction):
        return 3
    if instruction.name == "vstr":
        return model.fpu_store_behind_access if _is_access(before) else model.fpu_store_alone
    follows = before is not None and before.kind == "load" and not before.writes & instruction.address_reads
    return 2 if instruction.register_offset and not follows else 1


def _fpu_move(instruction: Instruction) -> int:
    """VMOV between core and FPU registers takes two cycles, among the FPU's one (table 7-1)."""
    registers = instruction.reads | instruction.writes
    core = any(register[0] == "r" or register in ("sp", "lr", "ip", "fp", "sb", "sl") for register in registers)
    return 2 if core else 1


def _issue(model: Model, instruction: Instruction, before: Instruction | None) -> int:
    """Cycles by the tables, a branch as not taken."""
    name = instruction.name
    if name in MULTIPLE:
        return 1 + instruction.units
    if instruction.kind == "load":
        return _load(model, instruction, before)
    if instruction.kind == "store":
        return _store(model, instruction, before)
    if name in ("vdiv", "vsqrt"):
        return 14
    if name in MULTIPLY_ACCUMULATE:
        return 3
    if name == "vmov":
        return _fpu_move(instruction)
    if name in DIVIDES:
        return model.divide
    if name in ("tbb", "tbh"):
        return 3
    if instruction.branches and name == "ldr":
        return 2
    return model.it if name == "it" else 1


def _wait(instruction: Instruction, before: Instruction | None) -> int:
    """Cycles that an instruction waits for the result of the one before it."""
    if before is None:
        return 0
    if before.name in FPU_ARITHMETIC:
        used = instruction.reads - instruction.addend
        return 1 if before.writes & used else 0
    produces = before.kind == "integer" and before.name != "it"
    return 1 if produces and before.writes & instruction.address_reads else 0


def block_cycles(model: Model, block: list[Instruction], before: Instruction | None) -> list[int]:
    """Return the cycles of each instruction of a block run from its first to its last, without the last one's refill.

    Parameters
    ----------
    before
        The instruction executed right before the block, if there was one.
    """
    cycles = []
    hidden = 0  # cycles that a division before still has to go, while the integer side is free
    for instruction in block:
        cost = _issue(model, instruction, before) + _wait(instruction, before)
        if model.integer_beside_fpu_divide:
            on_fpu = instruction.name.startswith("v")
            if on_fpu:
                cost, hidden = cost + hidden, 0
            else:
                hidden = max(0, hidden - cost)
            if instruction.name in ("vdiv", "vsqrt"):
                cost, hidden = cost - 13, 13
        cycles.append(cost)
        before = instruction
    if cycles:
        cycles[-1] += hidden
    return cycles
