"""The counter on snippets whose instructions and cycles were added up by hand from the tables of the manual."""

import json
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
from step_cost.calls import UnknownCallError
from step_cost.cycles import UnknownInstructionError
from step_cost.image import Image
from step_cost.machine import SCRATCH, Machine, MachineError
from step_cost.paths import Activation, Blocks, Cost, PathCost
from step_cost.stack import StackDepths, StackError, usage

HEAD = ".syntax unified\n.cpu cortex-m4\n.fpu fpv4-sp-d16\n.thumb\n.text\n"
ARGUMENTS = (SCRATCH, 1, SCRATCH + 64, 4)  # r0 … r3: two places in RAM and two numbers


class Snippet(NamedTuple):
    """Code of a function `f`, and what one call of it costs: refills of 1, 2 and 3 cycles in the three models."""

    code: str
    instructions: int
    low: int
    cycles: int
    high: int


RETURN = "bx lr"  # 1 + P
SNIPPETS = {
    "data processing takes one": Snippet("movs r0, #1\n adds r0, #2\n bx lr", 3, 2 + 2, 2 + 3, 2 + 4),
    # movs, five subs, five bne of which four are taken, bx
    "a taken branch refills, the last one is not taken": Snippet(
        "movs r0, #5\n 1: subs r0, #1\n bne 1b\n bx lr", 12, 12 + 5 * 1, 12 + 5 * 2, 12 + 5 * 3
    ),
    # r1 is 1: one of the two is skipped, and takes its cycle; IT may be folded
    "what an IT skips counts": Snippet(
        "cmp r1, #0\n ite eq\n moveq r2, #1\n movne r2, #2\n bx lr", 5, 4 + 1 + 1 - 1, 5 + 2, 5 + 3
    ),
    "a load takes two": Snippet("ldr r2, [r0]\n bx lr", 2, 2 + 2, 2 + 3, 2 + 4),
    "a load behind a load is pipelined": Snippet("ldr r2, [r0]\n ldr r3, [r0, #4]\n bx lr", 3, 3 + 2, 3 + 3, 3 + 4),
    # at SCRATCH lies SCRATCH itself
    "unless its address is what was loaded": Snippet("ldr r2, [r0]\n ldr r3, [r2]\n bx lr", 3, 4 + 2, 4 + 3, 4 + 4),
    "an address waits for data processing": Snippet("adds r0, #4\n ldr r2, [r0]\n bx lr", 3, 4 + 2, 4 + 3, 4 + 4),
    "but other data does not": Snippet("adds r1, #4\n ldr r2, [r0]\n bx lr", 3, 3 + 2, 3 + 3, 3 + 4),
    "a store with an immediate takes one": Snippet("str r1, [r0, #4]\n bx lr", 2, 1 + 2, 1 + 3, 1 + 4),
    "a store with a register takes two": Snippet("str r1, [r0, r3]\n bx lr", 2, 2 + 2, 2 + 3, 2 + 4),
    "multiple transfers take one and one a word": Snippet(
        "push {r4, r5, lr}\n pop {r4, r5, pc}", 2, 4 + 4 + 1, 4 + 4 + 2, 4 + 4 + 3
    ),
    "a division takes two to twelve": Snippet("udiv r2, r0, r3\n bx lr", 2, 2 + 2, 12 + 3, 12 + 4),
    "FPU arithmetic takes one": Snippet("vmul.f32 s2, s0, s1\n vadd.f32 s3, s0, s1\n bx lr", 3, 2 + 2, 2 + 3, 2 + 4),
    "and one more where the next needs it": Snippet(
        "vmul.f32 s2, s0, s1\n vadd.f32 s3, s2, s1\n bx lr", 3, 3 + 2, 3 + 3, 3 + 4
    ),
    "VABS is no arithmetic": Snippet("vabs.f32 s2, s0\n vadd.f32 s3, s2, s1\n bx lr", 3, 2 + 2, 2 + 3, 2 + 4),
    "an addend does not wait": Snippet("vmul.f32 s2, s0, s1\n vmla.f32 s2, s3, s4\n bx lr", 3, 4 + 2, 4 + 3, 4 + 4),
    "a factor does": Snippet("vmul.f32 s2, s0, s1\n vmla.f32 s5, s2, s4\n bx lr", 3, 5 + 2, 5 + 3, 5 + 4),
    "VDIV takes fourteen, and waits like arithmetic": Snippet(
        "vdiv.f32 s2, s0, s1\n vadd.f32 s3, s2, s1\n bx lr", 3, 16 + 2, 16 + 3, 16 + 4
    ),
    # low: two additions and the branch's cycle run beside the division, 13 - 3 are left at the end; its refill does not
    "integers beside VSQRT": Snippet("vsqrt.f32 s2, s0\n adds r1, #1\n adds r1, #1\n bx lr", 4, 14 + 1, 16 + 3, 16 + 4),
    "moves between the sides take two, others one": Snippet(
        "vmov s0, r1\n vmov.f32 s1, #1.0\n vmov.f32 s2, s1\n bx lr", 4, 4 + 2, 4 + 3, 4 + 4
    ),
    # FPU loads: pipelined but in the high model. FPU stores: two, behind an access one, in the low model always one
    "FPU loads and stores": Snippet(
        "vldr s0, [r0]\n vldr s1, [r0, #4]\n vstr s0, [r2]\n bx lr", 4, 3 + 1 + 2, 3 + 1 + 3, 4 + 2 + 4
    ),
    "a lone FPU store": Snippet("vstr s0, [r2]\n bx lr", 2, 1 + 2, 2 + 3, 2 + 4),
    "an FPU double is two words": Snippet(
        "vldr d0, [r0]\n vpush {d0, d1}\n add sp, #16\n bx lr", 4, 3 + 5 + 1 + 2, 12, 13
    ),
    # r1 is 1: over the first case, to the second
    "a table branch": Snippet("tbb [pc, r1]\n .byte 1, 2\n nop\n bx lr", 2, 4 + 2, 4 + 4, 4 + 6),
    "a load from beside the code": Snippet("ldr r2, 1f\n bx lr\n .align 2\n 1: .word 0", 2, 2 + 2, 2 + 3, 3 + 4),
}


def built(folder: Path, code: str, name: str = "snippet") -> Path:
    source, image = folder / f"{name}.s", folder / f"{name}.elf"
    source.write_text(HEAD + code + "\n")
    made = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-nostdlib"]
    subprocess.run([*made, "-Wl,-Ttext=0x08000000,-e,f", str(source), "-o", str(image)], check=True)
    return image


def function(name: str, code: str) -> str:
    return f".type {name}, %function\n.global {name}\n{name}: {code}\n.size {name}, . - {name}\n"


def costed(image: Path) -> PathCost:
    machine, elf = Machine(image), Image(image)
    machine.write(SCRATCH, SCRATCH.to_bytes(4, "little"))
    machine.begin_call()
    machine.call(elf.function("f"), *ARGUMENTS)
    return Blocks(elf, machine.block_bytes).cost(machine.path.tobytes())


@pytest.mark.parametrize("snippet", SNIPPETS.values(), ids=SNIPPETS.keys())
def test_snippet_costs_what_was_added_up_by_hand(snippet: Snippet, tmp_path: Path) -> None:
    cost = costed(built(tmp_path, function("f", snippet.code))).total
    assert cost == Cost(snippet.instructions, snippet.low, snippet.cycles, snippet.high)


# ---- functions


def test_calls_returns_and_tail_calls_are_told_apart(tmp_path: Path) -> None:
    f = function("f", "push {r4, lr}\n bl g\n pop {r4, lr}\n b h")  # 4 instructions, then on to h
    g = function("g", "nop\n bx lr")
    h = function("h", "nop\n nop\n bx lr")
    cost = costed(built(tmp_path, f + g + h))
    by_name = {activation.function: activation.cost.instructions for activation in cost.activations}
    assert by_name == {"g": 2, "h": 3, "f": 4 + 2 + 3}
    assert {name: own.instructions for name, own in cost.own.items()} == {"f": 4, "g": 2, "h": 3}


def test_a_call_costs_its_caller_the_branch_and_the_called_the_return(tmp_path: Path) -> None:
    cost = costed(built(tmp_path, function("f", "mov r4, lr\n bl g\n bx r4") + function("g", "bx lr")))
    assert cost.own["g"].cycles == 1 + 2
    assert cost.own["f"].cycles == 1 + (1 + 2) + (1 + 2)


def test_spans_of_a_path_add_up_to_the_activation(tmp_path: Path) -> None:
    image = built(tmp_path, function("f", "mov r4, lr\n bl g\n bl g\n bx r4") + function("g", "adds r1, #1\n bx lr"))
    machine, elf = Machine(image), Image(image)
    machine.begin_call()
    machine.call(elf.function("f"), *ARGUMENTS)
    blocks, path = Blocks(elf, machine.block_bytes), machine.path.tobytes()

    def spent(activation: Activation) -> tuple[int, int]:
        span = (activation.begin, activation.end)
        return sum(blocks.executed(path, *span).values()), sum(blocks.by_instruction(path, *span).values())

    activations = blocks.cost(path).activations
    assert [spent(activation) for activation in activations] == [
        (activation.cost.instructions, activation.cost.cycles) for activation in activations
    ]
    assert [activation.function for activation in activations] == ["g", "g", "f"]


# ---- what must be refused


def test_instruction_without_a_figure_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(UnknownInstructionError, match=r"no cycles known for 'pkhbt .*' at 0x08000000: add it"):
        costed(built(tmp_path, function("f", "pkhbt r0, r1, r2\n bx lr")))


def test_access_outside_of_memory_stops_with_the_place(tmp_path: Path) -> None:
    image = built(tmp_path, function("f", "movs r2, #0\n ldr r2, [r2]\n bx lr"))
    with pytest.raises(MachineError, match="stopped at 0x08000002"):
        costed(image)


# ---- the stack


def depths(folder: Path, code: str, frames: str = "snippet.s:1:1:nobody\t0\tstatic\n") -> StackDepths:
    image = built(folder, code)
    (folder / "snippet.su").write_text(frames)
    return StackDepths(Image(image), folder)


TABLE = "\n.section .rodata\n.type handlers, %object\nhandlers: .word g, h\n.size handlers, . - handlers\n.text\n"


def test_deepest_chain_goes_through_the_table_of_handlers(tmp_path: Path) -> None:
    receive = function("app_receive", "push {r4, lr}\n sub sp, #8\n blx r3\n add sp, #8\n pop {r4, pc}")
    f = function("f", "push {lr}\n bl app_receive\n pop {pc}")
    g = function("g", "push {r4, r5, lr}\n pop {r4, r5, pc}")
    h = function("h", "vpush {s16, s17}\n vpop {s16, s17}\n bx lr")
    chain = depths(tmp_path, f + receive + g + h + TABLE).of("f")
    assert chain.frames == (("f", 4), ("app_receive", 8 + 8), ("g", 12))
    assert chain.total_bytes == 32


def test_stack_usage_left_by_an_object_that_is_no_longer_built_is_passed_over(tmp_path: Path) -> None:
    command = {"directory": ".", "command": "cc -O2 -o objects/new.c.obj -c new.c", "file": "new.c"}
    (tmp_path / "objects").mkdir()
    for name, size in (("new", 8), ("old", 496)):
        (tmp_path / "objects" / f"{name}.c.su").write_text(f"{name}.c:1:1:f\t{size}\tstatic\n")
    assert usage(tmp_path) == {"f": 496}
    (tmp_path / "compile_commands.json").write_text(json.dumps([command]))
    assert usage(tmp_path) == {"f": 8}


def test_painted_stack_is_the_chain_of_calls(tmp_path: Path) -> None:
    code = function("f", "push {r4, lr}\n sub sp, #24\n str r1, [sp]\n bl g\n add sp, #24\n pop {r4, pc}")
    code += function("g", "push {r4, r5, r6, lr}\n pop {r4, r5, r6, pc}")
    image = built(tmp_path, code)
    machine, elf = Machine(image), Image(image)
    machine.paint_stack()
    machine.call(elf.function("f"), *ARGUMENTS)
    assert machine.stack_used_bytes() == depths(tmp_path, code).of("f").total_bytes == 8 + 24 + 16


def test_tail_call_gives_its_frame_back_first(tmp_path: Path) -> None:
    f = function("f", "push {r4, r5, r6, lr}\n pop {r4, r5, r6, lr}\n b g")
    g = function("g", "push {r4, lr}\n pop {r4, pc}")
    assert depths(tmp_path, f + g).of("f").total_bytes == 16


def test_compilers_figure_counts_where_it_is_larger(tmp_path: Path) -> None:
    code = function("f", "push {r4, lr}\n pop {r4, pc}")
    assert depths(tmp_path, code, "a.c:1:2:f\t40\tstatic\n").of("f").total_bytes == 40


def test_call_through_an_unknown_pointer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownCallError, match=r"f calls through a pointer \('blx r3' at 0x08000002\)"):
        depths(tmp_path, function("f", "push {r4, lr}\n blx r3\n pop {r4, pc}"))


def test_recursion_is_refused(tmp_path: Path) -> None:
    code = function("f", "push {r4, lr}\n bl g\n pop {r4, pc}") + function("g", "push {lr}\n bl f\n pop {pc}")
    with pytest.raises(StackError, match="recursion: f → g → f"):
        depths(tmp_path, code).of("f")


def test_stack_of_unknown_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StackError, match=r"f has a stack of unknown size \(dynamic\)"):
        depths(tmp_path, function("f", "bx lr"), "a.c:1:2:f\t40\tdynamic\n")
