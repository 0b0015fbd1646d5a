"""Who calls whom in an image, from its instructions. What a pointer calls must be written down here, or is refused."""

import re
from dataclasses import dataclass, field

from step_cost.cycles import Decoder, Instruction, UnknownInstructionError
from step_cost.errors import CostError
from step_cost.image import Image

# Functions that call through a pointer, and the constant table that holds every function it can point to.
TABLES = {"app_receive": "handlers"}

# Functions of firmware/app/settings.c that call the port's memory: the port is in no image that is measured here, and
# its frames come on top of the stack that is told. Each in this list since a compiler may put any of them into another.
TO_THE_PORT = {
    "has_word",
    "holds",
    "make_blank",
    "read_slot",
    "settings_load",
    "settings_save",
    "survey_pages",
    "write_record",
}

TARGET = re.compile(r"#(0x[0-9a-f]+)$")
STACK_REGISTERS = re.compile(r"\{(.*)\}")


class UnknownCallError(CostError):
    """A call whose target is not known."""


@dataclass
class Function:
    """What one function does to the stack and to others."""

    name: str
    calls: list[tuple[int, str]] = field(default_factory=list)  # address behind the call, and who is called
    jumps: set[str] = field(default_factory=set)  # left for good, the stack as it was at the entry
    pushed_bytes: int = 0  # by its instructions, all of them added up


def _target(instruction: Instruction) -> int | None:
    found = TARGET.search(instruction.text)
    return int(found[1], 16) if found else None


def _pushed_bytes(instruction: Instruction) -> int:
    """Return how far an instruction of a prologue moves the stack pointer down."""
    if instruction.name in ("push", "vpush"):
        return 4 * instruction.units
    if instruction.name in ("stmdb", "str", "strd", "vstmdb") and re.search(r"\[sp, #-|sp!", instruction.text):
        step = re.search(r"\[sp, #-(0x[0-9a-f]+|\d+)\]!", instruction.text)
        return int(step[1], 0) if step else 4 * instruction.units
    moved = re.match(r"sub(?:\.w|w)? sp,(?: sp,)? #(0x[0-9a-f]+|\d+)$", instruction.text)
    return int(moved[1], 0) if moved else 0


def _read(image: Image, name: str, code: list[Instruction]) -> Function:
    function = Function(name)
    for instruction in code:
        function.pushed_bytes += _pushed_bytes(instruction)
        if instruction.name in ("bl", "b"):
            target = _target(instruction)
            where = image.function_at(target) if target is not None else name
            if instruction.name == "bl":
                function.calls.append((instruction.end, where))
            elif where != name:
                _note_jump(image, function, where, target)
        elif instruction.name == "blx" or (instruction.name == "bx" and "lr" not in instruction.text):
            function.calls += [(instruction.end, called) for called in _through_pointer(image, name, instruction)]
    return function


def _note_jump(image: Image, function: Function, where: str, target: int | None) -> None:
    """Note a tail call, or a jump into a part split off, which keeps the stack as it is."""
    if target == image.functions[where] and not where.endswith(".cold"):
        function.jumps.add(where)
    else:
        function.calls.append((0, where))


def _through_pointer(image: Image, name: str, instruction: Instruction) -> list[str]:
    if name.partition(".")[0] in TO_THE_PORT:
        return []
    table = TABLES.get(name)
    if table is None or table not in image.objects:
        known = ", ".join(f"{function} through {place}" for function, place in TABLES.items())
        raise UnknownCallError(
            f"{name} calls through a pointer ('{instruction.text}' at {instruction.address:#010x}), and what it can "
            f"call is not known: name its table in TABLES of tools/step_cost/calls.py (known: {known})"
        )
    start, size = image.objects[table]
    words = memoryview(image.data(start, size)).cast("I").tolist()
    starts = {address | 1: function for function, address in image.functions.items()}
    called = [starts[word] for word in words if word in starts]
    if not called:
        raise UnknownCallError(f"the table {table} of {name} holds no function")
    return called


def calls_of(image: Image) -> dict[str, Function]:
    """Return every function of an image."""
    decoder = Decoder()
    found = {}
    for name, address in image.functions.items():
        code: list[Instruction] = []
        for start, end in image.code_ranges(address):
            try:
                code += decoder.decode(image.data(start, end - start), start)
            except UnknownInstructionError as error:
                raise UnknownInstructionError(f"in {name}: {error}") from error
        found[name] = _read(image, name, code)
    return found
