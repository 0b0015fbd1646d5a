"""What the wire definition asks of a CAN bus: bits, load and worst-case response times, from the DBC alone.

Response times after Davis, Burns, Bril and Lukkien, 'Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised' (2007): a frame waits for the longest frame of lower priority that has just begun, and for all of
higher priority; every instance in its busy period counts. Releases are taken to fall as unluckily as they can, whatever
the order of a tick.

A frame with a cycle time must be through before the next one is due. A frame on request has no cycle time:

- one that outranks a cyclic frame (COMMAND) may come as often as the shortest cycle, and delays all below it;
- one below the cyclic frames may be under way when any other is due, and blocks it; it has what time the others leave.
  It waits for no other request: a host asks one thing at a time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cantools.database.can import Message

from host_sim.codec import NODES
from host_sim.errors import OmnibotError

LOAD_LIMIT = 0.70
LONG_FRAMES_LIMIT = 5  # frames of 8 bytes a tick: one less is allowed
LONG_FRAME_BYTES = 8

# Times are whole numbers of 1/1000 bit: a bit rate of any whole number and a cycle of any millisecond are exact.
_PER_BIT = 1000


def worst_case_bits(length_bytes: int) -> int:
    """Return the bits of a frame with an 11-bit identifier, worst-case stuffing and the space to the next one included.

    47 bits of a frame are not data; of these, 34 can be stuffed, as can the data: a bit after every four at the worst.
    """
    return 8 * length_bytes + 47 + (34 + 8 * length_bytes - 1) // 4


@dataclass(frozen=True)
class Stream:
    """Frames of one identifier: a release every ``period`` at most, in any one unit of time.

    Attributes
    ----------
    duration
        Time on the bus.
    period
        Least time between two releases; None: a single one, that delays others only by being under way.
    jitter
        How much later than its turn a release may come.
    """

    duration: int
    period: int | None
    jitter: int = 0


def response_time(streams: Sequence[Stream], place: int, bit: int) -> int | None:
    """Return the worst-case response time of one of some streams in order of priority, highest first.

    None: the frames above it and its own fill the bus, so that there is no bound. ``bit`` is the time of one bit: a
    frame released within it still takes part in the arbitration.
    """
    own = streams[place]
    blocking = max((stream.duration for stream in streams[place + 1 :]), default=0)
    above = [(s.duration, s.period, s.jitter) for s in streams[:place] if s.period is not None]
    if own.period is None:
        wait = _settle(blocking, 0, above, bit)
        return None if wait is None else wait + own.duration
    busy = _settle(blocking + own.duration, blocking, [*above, (own.duration, own.period, own.jitter)], 0)
    if busy is None:
        return None
    instances = -(-(busy + own.jitter) // own.period)
    waits = [_settle(blocking + q * own.duration, blocking + q * own.duration, above, bit) for q in range(instances)]
    return max(own.jitter + wait - q * own.period + own.duration for q, wait in enumerate(waits) if wait is not None)


def _settle(start: int, fixed: int, above: Sequence[tuple[int, int, int]], bit: int) -> int | None:
    """Return the least t, from ``start``, that is fixed + Σ ⌈(t + jitter + bit) / period⌉ duration; None: none is."""
    if not _has_room(above):
        return None
    t = start
    while True:
        longer = fixed + sum(-(-(t + jitter + bit) // period) * duration for duration, period, jitter in above)
        if longer <= t:
            return t
        t = longer


def _has_room(above: Sequence[tuple[int, int, int]]) -> bool:
    """Whether the frames leave any of the bus free."""
    shared = math.lcm(*(period for _, period, _ in above))
    return sum(duration * (shared // period) for duration, period, _ in above) < shared


@dataclass(frozen=True)
class FrameLoad:
    """What one frame of one node asks of the bus.

    Attributes
    ----------
    period_s
        Cycle time; None: on request.
    response_s
        From its release to its end, at the worst; None: without bound.
    """

    name: str
    node: int
    arbitration_id: int
    length_bytes: int
    bits: int
    period_s: float | None
    response_s: float | None

    @property
    def in_time(self) -> bool:
        """Whether it is through before the next one is due; on request, whether it gets through at all."""
        return self.response_s is not None and (self.period_s is None or self.response_s <= self.period_s)


@dataclass(frozen=True)
class BusLoad:
    """What some robots of one wire definition ask of a bus; ``frames`` in order of priority, those of all nodes."""

    bit_rate: int
    nodes: int
    tick_s: float
    frames: tuple[FrameLoad, ...]

    @property
    def tick_frames(self) -> list[FrameLoad]:
        """The frames of one robot that go over the bus at each tick."""
        return [frame for frame in self.frames if frame.period_s == self.tick_s and frame.node == 0]

    @property
    def bits_per_tick(self) -> int:
        """Bits of these frames, worst-case stuffing included."""
        return sum(frame.bits for frame in self.tick_frames)

    @property
    def load_fraction(self) -> float:
        """Share of the bus that the cyclic frames of all robots take."""
        return sum(frame.bits / frame.period_s for frame in self.frames if frame.period_s) / self.bit_rate

    @property
    def failures(self) -> list[str]:
        """What does not hold, a line each."""
        lines = []
        if self.load_fraction > LOAD_LIMIT:
            lines.append(f"the load of {self.load_fraction:.1%} is above {LOAD_LIMIT:.0%}")
        long = sum(frame.length_bytes >= LONG_FRAME_BYTES for frame in self.tick_frames)
        if long >= LONG_FRAMES_LIMIT:
            lines.append(f"{long} frames of 8 bytes a tick; it must be fewer than {LONG_FRAMES_LIMIT}")
        late = dict.fromkeys(frame.name for frame in self.frames if not frame.in_time)
        if late:
            lines.append(f"too late at the worst: {', '.join(late)}")
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "frames_per_tick": len(self.tick_frames),
            "bits_per_tick": self.bits_per_tick,
            "load_fraction": self.load_fraction,
            "bit_rate": self.bit_rate,
            "nodes": self.nodes,
            "tick_s": self.tick_s,
            "failures": self.failures,
            "frames": [{**vars(frame), "in_time": frame.in_time} for frame in self.frames],
        }


def bus_load(messages: Sequence[Message], nodes: int = 1, bit_rate: int = 1_000_000) -> BusLoad:
    """Compute the load of so many robots on one bus from the messages of a wire definition, identifiers of node 0."""
    if not 1 <= nodes <= NODES:
        raise OmnibotError(f"{nodes} nodes: must be 1 … {NODES}")
    if not 10_000 <= bit_rate <= 1_000_000:
        raise OmnibotError(f"a bit rate of {bit_rate} bit/s: classic CAN has 10000 … 1000000")
    messages = sorted(messages, key=lambda message: message.frame_id)
    cycles_ms = [message.cycle_time for message in messages if message.cycle_time]
    if not cycles_ms:
        raise OmnibotError("no message has a cycle time (GenMsgCycleTime): there is no load to compute")
    last_cyclic = max(message.frame_id for message in messages if message.cycle_time)
    sent = [(message, node) for message in messages for node in range(nodes)]
    streams = [_stream(message, min(cycles_ms), last_cyclic, bit_rate) for message, _ in sent]
    frames = (
        _frame_load(message, node, response_time(streams, place, _PER_BIT), bit_rate)
        for place, (message, node) in enumerate(sent)
    )
    return BusLoad(bit_rate, nodes, min(cycles_ms) * 1e-3, tuple(frames))


def _stream(message: Message, tick_ms: int, last_cyclic: int, bit_rate: int) -> Stream:
    """Return what the analysis is to take a message for."""
    period_ms = message.cycle_time or (tick_ms if message.frame_id < last_cyclic else None)
    # ms · bit/s are thousandths of a bit.
    return Stream(worst_case_bits(message.length) * _PER_BIT, None if period_ms is None else period_ms * bit_rate)


def _frame_load(message: Message, node: int, response: int | None, bit_rate: int) -> FrameLoad:
    return FrameLoad(
        name=message.name,
        node=node,
        arbitration_id=message.frame_id | node,
        length_bytes=message.length,
        bits=worst_case_bits(message.length),
        period_s=message.cycle_time * 1e-3 if message.cycle_time else None,
        response_s=None if response is None else response / (_PER_BIT * bit_rate),
    )


def load_table(load: BusLoad) -> str:
    """Return what `bus_load` found as a table: a row a frame, highest priority first."""
    lines = [f"{'id':>5}  {'message':<17}{'bytes':>5}{'bits':>6}{'period':>12}{'response':>12}"]
    for frame in load.frames:
        period = f"{frame.period_s * 1e3:g} ms" if frame.period_s else "on request"
        response = "no bound" if frame.response_s is None else f"{frame.response_s * 1e3:.3f} ms"
        late = "" if frame.in_time else "  too late"
        lines.append(
            f"0x{frame.arbitration_id:03X}  {frame.name:<17}{frame.length_bytes:>5}{frame.bits:>6}"
            f"{period:>12}{response:>12}{late}"
        )
    robots = "1 robot" if load.nodes == 1 else f"{load.nodes} robots"
    lines.append(
        f"{robots}, {len(load.tick_frames)} frames of {load.bits_per_tick} bits a tick each, stuffed at the worst: "
        f"{load.load_fraction:.1%} of {load.bit_rate / 1e6:g} Mbit/s"
    )
    return "\n".join(lines)
