"""The corpus through the emulated firmware: what every step, message and tick of it cost."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from step_cost.corpus import NODE, SETUP, TICK, FrameIn, Session
from step_cost.errors import CostError
from step_cost.image import Image
from step_cost.machine import FRAME, FRAME_BYTES, INSTANCE, Machine
from step_cost.paths import NOTHING, Blocks, Cost, PathCost

STEP = ("trajectory_reference", "control_step")


class Target:
    """The firmware's calls (firmware/ports/posix/inproc.h) on the emulated processor."""

    def __init__(self, image: Image) -> None:
        self.image = image
        self.machine = Machine(image.file)
        self.blocks = Blocks(image, self.machine.block_bytes)
        self._receive, self._transmit = image.functions["omnibot_receive"], image.functions["omnibot_transmit"]

    def start(self, node: int) -> None:
        """Make the firmware new."""
        self.machine.call(self.image.functions["omnibot_init"], INSTANCE, node)

    def exchange(self, frames: Iterable[FrameIn], then: Callable[[], None] | None = None) -> list[FrameIn]:
        """Give frames to the firmware, take its answers out until there are none, and return them.

        ``then`` is what is called between the two.
        """
        machine = self.machine
        del machine.path[:]
        for identifier, data in frames:
            machine.write(FRAME, identifier.to_bytes(2, "little") + bytes((len(data),)) + data.ljust(8, b"\0"))
            machine.begin_call()
            machine.call(self._receive, INSTANCE, FRAME)
        if then is not None:
            then()
        answers: list[FrameIn] = []
        while True:
            machine.begin_call()
            if not machine.call(self._transmit, INSTANCE, FRAME) & 0xFF:
                return answers
            raw = machine.read(FRAME, FRAME_BYTES)
            answers.append(FrameIn(int.from_bytes(raw[:2], "little"), raw[3 : 3 + raw[2]]))

    def path(self) -> bytes:
        """Return the path of the last exchange."""
        return self.machine.path.tobytes()


class Range(NamedTuple):
    """A figure over the corpus."""

    minimum: int
    median: int
    maximum: int


@dataclass
class Figures:
    """Costs of one thing, and how often each came up."""

    seen: Counter[Cost] = field(default_factory=Counter)

    def add(self, cost: Cost, times: int = 1) -> None:
        """Note a cost."""
        self.seen[cost] += times

    def range_of(self, part: str) -> Range:
        """Return minimum, median and maximum of 'instructions', 'low', 'cycles' or 'high'."""
        if not self.seen:
            # Recorded with this host's library; an image of another protocol or parameter list does not take it.
            raise CostError(
                "the recorded frames did not drive the target's firmware: it is of another build than the host's; "
                "tools/build host && tools/build target"
            )
        values = sorted((getattr(cost, part), times) for cost, times in self.seen.items())
        middle = (sum(times for _, times in values) + 1) // 2
        passed = np.cumsum([times for _, times in values])
        return Range(values[0][0], values[int(np.searchsorted(passed, middle))][0], values[-1][0])

    @property
    def count(self) -> int:
        """How many were seen."""
        return sum(self.seen.values())


class Class(NamedTuple):
    """What a session is about, as far as the cost of its ticks depends on it."""

    order: str
    output: str


@dataclass
class Measurement:
    """Everything counted over the corpus."""

    steps: dict[Class, Figures] = field(default_factory=lambda: defaultdict(Figures))
    ticks: dict[tuple[Class, str], Figures] = field(default_factory=lambda: defaultdict(Figures))
    functions: dict[str, Figures] = field(default_factory=lambda: defaultdict(Figures))
    paths: dict[tuple[Class, str], Counter[bytes]] = field(default_factory=lambda: defaultdict(Counter))
    painted_stack_bytes: int = 0  # the deepest that any group of frames went


def step_cost(path: PathCost) -> Cost | None:
    """Return trajectory evaluation and control step of a tick together, None where there was no step."""
    costs = [path.of(function) for function in STEP]
    return None if NOTHING in costs else costs[0].plus(costs[1])


def run_session(target: Target, session: Session, measurement: Measurement) -> None:
    """Put one session through the emulated firmware, count the paths of its groups and see how deep the stack went."""
    target.start(NODE)
    target.machine.paint_stack()
    key = Class(session.order, session.output)
    for group in session.groups:
        target.exchange(group.frames)
        measurement.paths[key, group.kind][target.path()] += 1
    measurement.painted_stack_bytes = max(measurement.painted_stack_bytes, target.machine.stack_used_bytes())


def evaluate(target: Target, measurement: Measurement) -> None:
    """Work out what the paths cost."""
    for function in STEP:
        target.image.function(function)  # inlined, it could not be told from its caller
    for (key, kind), paths in measurement.paths.items():
        for path, times in paths.items():
            cost = target.blocks.cost(path)
            if kind != SETUP:
                measurement.ticks[key, kind].add(cost.total, times)
            step = step_cost(cost)
            if step is not None and kind == TICK:
                measurement.steps[key].add(step, times)
            for activation in cost.activations:
                measurement.functions[activation.function].add(activation.cost, times)
