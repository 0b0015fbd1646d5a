"""A long drive with random faults in one process: memory must stay where it is, every end of a drive be explained."""

import gc
import random
import resource
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from host_sim.faults import OF_A_FRAME, Fault, FaultPlan, Kind, Way
from host_sim.inject import UNEXPLAINED, Outcome, Session
from host_sim.planner import PathRequest
from host_sim.scenario import PACES

TICKS_PER_S = 1000
EPISODE_TICKS = 10_000
WARM_UP_FRACTION = 0.1  # of the time: what is compiled, cached and grown at first use
MESSAGES = ((), ("POSE",), ("WHEEL_SPEED",), ("SYNC",), ("TORQUE",), ("POSE", "WHEEL_SPEED"))
REQUESTS = (
    PathRequest("rhombus", 0.5, duration_s=EPISODE_TICKS / TICKS_PER_S),
    PathRequest("rhombus", 1.0, corner="sharp", duration_s=5.0),
    PathRequest("circle", 0.3, duration_s=EPISODE_TICKS / TICKS_PER_S),
    PathRequest("lemniscate", 0.7, duration_s=EPISODE_TICKS / TICKS_PER_S),
    PathRequest("line", 0.2, duration_s=EPISODE_TICKS / TICKS_PER_S),
)


@dataclass
class Memory:
    """What the process holds: its largest resident set so far, and Python's blocks now."""

    peak_KiB: int  # noqa: N815
    blocks: int

    @classmethod
    def now(cls) -> "Memory":
        """Return what it is at this moment, without what only waits to be collected."""
        gc.collect()
        return cls(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, sys.getallocatedblocks())


@dataclass
class SoakResult:
    """What a soak came to."""

    seed: int
    simulated_s: float = 0.0
    wall_s: float = 0.0
    drives: int = 0
    frames_hit: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    max_torque_Nm: float = 0.0
    problems: list[str] = field(default_factory=list)
    peak_KiB_after_warm_up: int = 0  # noqa: N815
    peak_growth_KiB: int = 0  # noqa: N815
    block_growth: int = 0

    def progress(self, duration_s: float, wall_s: float) -> float:
        """Return how much is done of what was asked for: 1 or more at the end."""
        return max(self.simulated_s / duration_s, self.wall_s / wall_s)

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self) | {"ends": dict(self.ends.most_common())}


def random_plan(chance: random.Random, ticks: int) -> FaultPlan:
    """Return one to three faults somewhere in a drive of so many ticks."""
    return FaultPlan(tuple(_random_fault(chance, ticks) for _ in range(chance.randint(1, 3))), chance.getrandbits(32))


def _random_fault(chance: random.Random, ticks: int) -> Fault:
    kind = chance.choice(list(Kind))
    first_tick = chance.randrange(ticks)
    if kind in OF_A_FRAME:
        return Fault(
            kind,
            chance.choice(MESSAGES),
            chance.choice(list(Way)),
            first_tick,
            chance.choice((5, 50, 500, 2000)),
            chance.choice((0.01, 0.1, 0.3, 1.0)),
            chance.randint(1, 5),
        )
    return Fault(kind, first_tick=first_tick, ticks=chance.choice((1, 5, 50, 500)), rate=chance.choice((0.3, 0.8, 1.0)))


def soak(duration_s: float, wall_s: float, result: SoakResult) -> None:
    """Drive with random faults for so long in simulated time, but no longer than ``wall_s`` by the clock.

    ``result`` brings the seed, and holds at any time what was found until then.

    One firmware is driven by the host's ticks and one by its own timer, in turn. After each drive with faults it is
    started again and must follow its path as if nothing had been.
    """
    chance, begin_s = random.Random(result.seed), time.monotonic()
    settled: Memory | None = None
    with Session(PACES[0]) as first, Session(PACES[1]) as second:
        while result.progress(duration_s, wall_s) < 1.0:
            _one_drive(chance.choice((first, second)), chance, result)
            result.wall_s = time.monotonic() - begin_s
            if settled is None and result.progress(duration_s, wall_s) >= WARM_UP_FRACTION:
                settled = Memory.now()
    if settled is not None:
        now = Memory.now()
        result.peak_KiB_after_warm_up = settled.peak_KiB
        result.peak_growth_KiB = now.peak_KiB - settled.peak_KiB
        result.block_growth = now.blocks - settled.blocks


def _one_drive(session: Session, chance: random.Random, result: SoakResult) -> None:
    request = chance.choice(REQUESTS)
    faults = random_plan(chance, EPISODE_TICKS // 2)
    outcome = session.drive(request, faults, EPISODE_TICKS)
    again = session.drive(request, FaultPlan(), 500)
    result.drives += 1
    result.simulated_s += (outcome.ticks + again.ticks) / TICKS_PER_S
    result.frames_hit += outcome.hits
    result.ends[f"{session.time}: {outcome.end}"] += 1
    result.max_torque_Nm = max(result.max_torque_Nm, outcome.max_torque_Nm, again.max_torque_Nm)
    result.problems += [f"drive {result.drives}, {faults}: {what}" for what in _problems(outcome, again)]


def _problems(outcome: Outcome, again: Outcome) -> list[str]:
    found = [*outcome.violations, *again.violations]
    if outcome.end == UNEXPLAINED:
        found.append(f"ended in mode {outcome.mode} without a reason")
    if again.end != "completed":
        found.append(f"did not drive again: {again.end}")
    return found
