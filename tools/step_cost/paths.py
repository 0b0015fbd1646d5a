"""What a path through the firmware cost: instructions counted, cycles estimated, by function and by instruction.

A path is the addresses of the blocks executed, as machine.py notes them, with a 0 before each call from outside. Calls
and returns are read out of it: a call puts a function on the stack, coming back to the address behind the call takes
it and what it jumped on to (tail calls) off again. A function's figures are inclusive: with those of what it calls.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from step_cost.cycles import CENTRAL, MODELS, Decoder, Instruction, Model, block_cycles
from step_cost.image import Image

CALL_FROM_OUTSIDE = 0


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
    cost: Cost = NOTHING


class Blocks:
    """Decodes blocks and works out paths, each once."""

    def __init__(self, image: Image, block_bytes: dict[int, int]) -> None:
        self.image = image
        self._bytes = block_bytes
        self._decoder = Decoder()
        self._decoded: dict[int, list[Instruction]] = {}
        self._costs: dict[tuple[int, int], Cost] = {}
        self._paths: dict[bytes, PathCost] = {}

    def instructions(self, address: int) -> list[Instruction]:
        """Return the instructions of a block."""
        if address not in self._decoded:
            code = self.image.code(address, self._bytes[address])
            self._decoded[address] = self._decoder.decode(code, address)
        return self._decoded[address]

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
        total, own, done = NOTHING, dict[str, Cost](), list[Activation]()
        stack: list[_Frame] = []

        def charge(cost: Cost) -> None:
            nonlocal total
            total = total.plus(cost)
            frame = stack[-1]
            frame.cost = frame.cost.plus(cost)
            own[frame.function] = own.get(frame.function, NOTHING).plus(cost)

        def finish() -> None:
            frame = stack.pop()
            done.append(Activation(frame.function, frame.cost))
            if stack:
                stack[-1].cost = stack[-1].cost.plus(frame.cost)

        before = CALL_FROM_OUTSIDE
        for address in [*path, CALL_FROM_OUTSIDE]:
            last = self._last(before)
            if last is not None and address != last.end:
                charge(REFILL)
            if address == CALL_FROM_OUTSIDE:
                while stack:
                    finish()
            else:
                self._enter(stack, last, address, finish)
                charge(self._cost(before, address))
            before = address
        return PathCost(total, tuple(done), own)

    def _enter(self, stack: list[_Frame], last: Instruction | None, address: int, finish: Callable[[], None]) -> None:
        """Bring the stack of activations to a block: into a call, out of one, or on to another function."""
        function = self.image.function_at(address)
        if last is None:
            stack.append(_Frame(function, CALL_FROM_OUTSIDE))
        elif last.calls and address != last.end:
            stack.append(_Frame(function, last.end))
        elif address == stack[-1].back:
            back = address
            while len(stack) > 1 and stack[-1].back == back:
                finish()
        elif function != stack[-1].function:
            self._jump(stack, function, finish)

    @staticmethod
    def _jump(stack: list[_Frame], function: str, finish: Callable[[], None]) -> None:
        """Go on in another function without a call: a tail call, or back from a part split off."""
        back = stack[-1].back
        same = [frame.function for frame in stack if frame.back == back]
        if function in same:
            while stack[-1].function != function:
                finish()
        else:
            stack.append(_Frame(function, back))

    # ---- where the cycles go

    def by_instruction(self, path: bytes, model: Model = CENTRAL) -> Counter[int]:
        """Return the cycles spent at each address, refills with the branch that caused them."""
        spent: Counter[int] = Counter()
        before = CALL_FROM_OUTSIDE
        for address in [*memoryview(path).cast("I").tolist(), CALL_FROM_OUTSIDE]:
            last = self._last(before)
            if last is not None and address != last.end:
                spent[last.address] += model.refill
            if address != CALL_FROM_OUTSIDE:
                block = self.instructions(address)
                for instruction, cycles in zip(block, block_cycles(model, block, last), strict=True):
                    spent[instruction.address] += cycles
            before = address
        return spent
