"""What a path through the firmware cost: instructions counted, cycles estimated, by function and by instruction.

A path is the addresses of the blocks executed, as machine.py notes them, with a 0 before each call from outside. Calls
and returns are read out of it: a call puts a function on the stack, coming back to the address behind the call takes
it and what it jumped on to (tail calls) off again. A function's figures are inclusive: with those of what it calls.
"""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

from step_cost.cycles import CENTRAL, MODELS, Decoder, Instruction, Model, block_cycles
from step_cost.image import Image
from step_cost.machine import CALL_FROM_OUTSIDE


class Cost(NamedTuple):
    """Instructions are counted; cycles are the estimates of the three models."""

    instructions: int
    low: int
    cycles: int
    high: int

    def plus(self, other: "Cost") -> "Cost":
        """Return the sum."""
        return Cost(*(a + b for a, b in zip(self, other, strict=True)))


NOTHING = Cost(0, 0, 0, 0)
REFILL = Cost(0, *(model.refill for model in MODELS))


class Activation(NamedTuple):
    """One execution of a function, from its first instruction to its return, with all that it called."""

    function: str
    cost: Cost
    begin: int  # of the path, the place of its first block
    end: int  # and the place behind its last


@dataclass(frozen=True)
class PathCost:
    """Everything known of a path."""

    total: Cost
    activations: tuple[Activation, ...]
    own: dict[str, Cost]  # by function, without what it calls

    def of(self, function: str) -> Cost:
        """Return the sum over a function's activations."""
        total = NOTHING
        for activation in self.activations:
            if activation.function == function:
                total = total.plus(activation.cost)
        return total


@dataclass
class _Frame:
    function: str
    back: int  # where it returns to
    begin: int
    cost: Cost = NOTHING


class _Walk:
    """Follows calls and returns along a path, and charges what is on the stack."""

    def __init__(self) -> None:
        self.place = 0
        self.total = NOTHING
        self.own: dict[str, Cost] = {}
        self.done: list[Activation] = []
        self._stack: list[_Frame] = []

    def charge(self, cost: Cost) -> None:
        """Charge the function on top."""
        frame = self._stack[-1]
        frame.cost = frame.cost.plus(cost)
        self.total = self.total.plus(cost)
        self.own[frame.function] = self.own.get(frame.function, NOTHING).plus(cost)

    def enter(self, function: str, last: Instruction | None, address: int) -> None:
        """Come to a block: into a call, out of one, or on to another function."""
        stack = self._stack
        if last is None:
            stack.append(_Frame(function, CALL_FROM_OUTSIDE, self.place))
        elif last.calls and address != last.end:
            stack.append(_Frame(function, last.end, self.place))
        elif address == stack[-1].back:
            while len(stack) > 1 and stack[-1].back == address:
                self._finish()
        elif function != stack[-1].function:
            self._jump(function)

    def leave(self) -> None:
        """Return to outside."""
        while self._stack:
            self._finish()

    def _finish(self) -> None:
        frame = self._stack.pop()
        self.done.append(Activation(frame.function, frame.cost, frame.begin, self.place))
        if self._stack:
            self._stack[-1].cost = self._stack[-1].cost.plus(frame.cost)

    def _jump(self, function: str) -> None:
        """Go on in another function without a call: a tail call, or back from a part split off."""
        back = self._stack[-1].back
        if function in [frame.function for frame in self._stack if frame.back == back]:
            while self._stack[-1].function != function:
                self._finish()
        else:
            self._stack.append(_Frame(function, back, self.place))


class Blocks:
    """Decodes blocks and works out paths, each once."""

    def __init__(self, image: Image, block_bytes: dict[int, int]) -> None:
        self.image = image
        self._bytes = block_bytes
        self._decoder = Decoder()
        self._decoded: dict[int, list[Instruction]] = {}
        self._by_address: dict[int, Instruction] = {}
        self._costs: dict[tuple[int, int], Cost] = {}
        self._paths: dict[bytes, PathCost] = {}

    def instructions(self, address: int) -> list[Instruction]:
        """Return the instructions of a block."""
        if address not in self._decoded:
            code = self.image.data(address, self._bytes[address])
            self._decoded[address] = self._decoder.decode(code, address)
            self._by_address.update((instruction.address, instruction) for instruction in self._decoded[address])
        return self._decoded[address]

    def instruction_at(self, address: int) -> Instruction:
        """Return an instruction of a block that was executed."""
        return self._by_address[address]

    def _last(self, address: int) -> Instruction | None:
        return self.instructions(address)[-1] if address != CALL_FROM_OUTSIDE else None

    def _cost(self, before: int, address: int) -> Cost:
        """Return the cost of a block behind another one, without the refill at its own end."""
        key = (before, address)
        if key not in self._costs:
            block = self.instructions(address)
            cycles = (sum(block_cycles(model, block, self._last(before))) for model in MODELS)
            self._costs[key] = Cost(len(block), *cycles)
        return self._costs[key]

    def cost(self, path: bytes) -> PathCost:
        """Work out a path, given as machine words of block addresses."""
        if path not in self._paths:
            self._paths[path] = self._work_out(memoryview(path).cast("I").tolist())
        return self._paths[path]

    def _work_out(self, path: list[int]) -> PathCost:
        walk = _Walk()
        before = CALL_FROM_OUTSIDE
        for place, address in enumerate([*path, CALL_FROM_OUTSIDE]):
            walk.place = place
            last = self._last(before)
            if last is not None and address != last.end:
                walk.charge(REFILL)
            if address == CALL_FROM_OUTSIDE:
                walk.leave()
            else:
                walk.enter(self.image.function_at(address), last, address)
                walk.charge(self._cost(before, address))
            before = address
        return PathCost(walk.total, tuple(walk.done), walk.own)

    # ---- where the cycles go

    def by_instruction(self, path: bytes, begin: int, end: int, model: Model = CENTRAL) -> Counter[int]:
        """Return the cycles spent at each address between two places of a path, refills with what caused them."""
        spent: Counter[int] = Counter()
        addresses = [CALL_FROM_OUTSIDE, *memoryview(path).cast("I").tolist(), CALL_FROM_OUTSIDE]
        around = zip(addresses[begin:end], addresses[begin + 1 : end + 1], addresses[begin + 2 : end + 2], strict=True)
        for before, address, behind in around:
            if address == CALL_FROM_OUTSIDE:
                continue
            block = self.instructions(address)
            for instruction, cycles in zip(block, block_cycles(model, block, self._last(before)), strict=True):
                spent[instruction.address] += cycles
            if behind != block[-1].end:
                spent[block[-1].address] += model.refill
        return spent

    def executed(self, path: bytes, begin: int, end: int) -> Counter[int]:
        """Return how often each instruction between two places of a path was executed."""
        blocks = Counter(memoryview(path).cast("I")[begin:end].tolist())
        del blocks[CALL_FROM_OUTSIDE]
        times: Counter[int] = Counter()
        for address, number in blocks.items():
            for instruction in self.instructions(address):
                times[instruction.address] += number
        return times
