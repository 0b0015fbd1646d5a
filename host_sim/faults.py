"""A bus that fails by plan: a python-can bus around another one that loses, delays, repeats, swaps and damages frames.

Time is the control tick that ``begin_tick`` names, never the wall clock, and chance comes from the plan's seed: the
same plan does the same to the same frames. Before the first ``begin_tick``, and after ``end``, the bus is a good one.
"""

import random
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import can

from host_sim.busload import worst_case_bits
from host_sim.codec import Codec
from host_sim.errors import OmnibotError

FOREVER_TICKS = 1 << 32
BUS_BITS_PER_TICK = 1000  # 1 Mbit/s, 1 ms
QUEUE_FRAMES = 16  # that wait for a busy bus, a direction; the firmware's outbox holds as many
PAUSED_FRAMES = 1024  # that a stopped process finds in its socket when it goes on
BABBLE = can.Message(arbitration_id=0, is_extended_id=False, data=bytes(8))  # nothing wins against it


class Kind(StrEnum):
    """What goes wrong."""

    DROP = "drop"
    DELAY = "delay"
    REPEAT = "repeat"
    REORDER = "reorder"
    CORRUPT = "corrupt"
    FLOOD = "flood"
    PAUSE = "pause"
    RESTART = "restart"


OF_A_FRAME = frozenset((Kind.DROP, Kind.DELAY, Kind.REPEAT, Kind.REORDER, Kind.CORRUPT))


class Way(StrEnum):
    """Which frames, by where they go."""

    TO_ROBOT = "to robot"
    FROM_ROBOT = "from robot"
    BOTH = "both"


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong for some time.

    Attributes
    ----------
    kind
        What. ``reorder`` lets the next frame of the same direction pass first; ``flood`` is a babbling node at top
        priority; ``pause`` holds the robot and everything for it until the end of the window, ``restart`` kills it at
        the beginning and puts a new one in its place at the end.
    messages
        Names of the messages it meets; empty: all.
    way
        Their direction.
    first_tick, ticks
        The window.
    rate
        Probability for a frame, 0 … 1; of a flood: its share of the bus.
    amount
        Ticks of delay, further copies, or bits to flip.
    """

    kind: Kind
    messages: tuple[str, ...] = ()
    way: Way = Way.BOTH
    first_tick: int = 0
    ticks: int = FOREVER_TICKS
    rate: float = 1.0
    amount: int = 1

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not 0.0 <= self.rate <= 1.0:
            raise OmnibotError(f"{self.kind}: rate = {self.rate:g} must be 0 … 1")
        if self.first_tick < 0 or self.ticks < 1 or self.amount < 1:
            raise OmnibotError(
                f"{self.kind}: first_tick = {self.first_tick} must be at least 0, "
                f"ticks = {self.ticks} and amount = {self.amount} at least 1"
            )

    def acts_at(self, tick: int) -> bool:
        """Tell whether the window holds a tick."""
        return self.first_tick <= tick < self.first_tick + self.ticks


@dataclass(frozen=True)
class FaultPlan:
    """All that goes wrong in a run, and the seed of its chance."""

    faults: tuple[Fault, ...] = ()
    seed: int = 0


class _Lane:
    """One direction of the bus, and the frames under way on it."""

    def __init__(self, way: Way, deliver: Callable[[can.Message], None]) -> None:
        self.way = way
        self.deliver = deliver
        self.late: list[tuple[int, can.Message]] = []  # with the tick they are due at
        self.overtaken: can.Message | None = None  # goes after the next one
        self.queue: deque[can.Message] = deque()  # for a bus or a robot that does not take them

    def clear(self) -> None:
        self.late.clear()
        self.overtaken = None
        self.queue.clear()


class FaultyBus(can.BusABC):
    """A bus around another bus, whose frames meet the faults of a plan in both directions.

    Parameters
    ----------
    bus
        The bus that the robot is on. It is shut down with this one.
    codec
        The wire: a plan names messages.
    plan
        What goes wrong.
    revive
        Gives the bus with a new robot on it after a ``restart``.
    watch
        Is shown every frame at the robot's own end of the bus: whether it goes to the robot, and the frame.
    """

    def __init__(
        self,
        bus: can.BusABC,
        codec: Codec,
        plan: FaultPlan = FaultPlan(),
        revive: Callable[[], can.BusABC] | None = None,
        watch: Callable[[bool, can.Message], None] | None = None,
    ) -> None:
        self.channel_info = f"{bus.channel_info}, with faults"
        self.is_ours_alone = getattr(bus, "is_ours_alone", False)
        self._bus = bus
        self._codec = codec
        self._revive = revive
        self._watch = watch
        self._ready: deque[can.Message] = deque()
        self._to_robot = _Lane(Way.TO_ROBOT, self._give_robot)
        self._from_robot = _Lane(Way.FROM_ROBOT, self._ready.append)
        self._dead = False
        self.use(plan)
        super().__init__(channel=self.channel_info)

    # ---- the plan

    def use(self, plan: FaultPlan) -> None:
        """Follow another plan from the next ``begin_tick`` on, and forget what the last one did."""
        for fault in plan.faults:
            for name in fault.messages:
                self._check_name(name)
            if fault.kind is Kind.RESTART and self._revive is None:
                raise OmnibotError("this bus cannot restart its robot: leave 'restart' out of the plan")
        self.plan = plan
        self.hits: Counter[Kind] = Counter()
        self.first_hit_tick: int | None = None
        self.overflowed = 0  # frames that found the queue of a busy bus full
        self._random = random.Random(plan.seed)
        self._tick: int | None = None
        self._active: tuple[Fault, ...] = ()
        self._bits_left = BUS_BITS_PER_TICK
        self._flooded = self._paused = False

    def _check_name(self, name: str) -> None:
        try:
            self._codec[name]
        except KeyError:
            raise OmnibotError(f"the wire has no message {name!r}: take a name of protocol/omnibot.dbc") from None

    def begin_tick(self, tick: int) -> None:
        """Let the control tick begin: faults come and go, and frames whose time has come arrive."""
        self._tick = tick
        self._active = tuple(fault for fault in self.plan.faults if fault.acts_at(tick))
        kinds = {fault.kind for fault in self._active}
        self._live_or_die(Kind.RESTART in kinds)
        self._paused = Kind.PAUSE in kinds
        if self._paused:
            self._note_hit(Kind.PAUSE)
        self._babble()
        self._deliver_waiting()

    def end(self) -> None:
        """Be a good bus again; what was under way arrives now."""
        self._live_or_die(False)
        self._tick, self._active, self._flooded, self._paused = None, (), False, False
        self._deliver_waiting()

    @property
    def robot_is_away(self) -> bool:
        """Whether the robot does nothing now, because it is paused or dead."""
        return self._paused or self._dead

    @property
    def robot_is_dead(self) -> bool:
        """Whether there is no robot now."""
        return self._dead

    def _note_hit(self, kind: Kind) -> None:
        self.hits[kind] += 1
        if self.first_hit_tick is None:
            self.first_hit_tick = self._tick

    def _live_or_die(self, dead: bool) -> None:
        if dead and not self._dead:
            self._note_hit(Kind.RESTART)
            self._to_robot.clear()
            self._from_robot.clear()
            self._bus.shutdown()
        elif self._dead and not dead:
            assert self._revive is not None  # use() saw to it
            self._bus = self._revive()
        self._dead = dead

    def _babble(self) -> None:
        share = max((fault.rate for fault in self._active if fault.kind is Kind.FLOOD), default=0.0)
        self._flooded = share > 0.0
        self._bits_left = BUS_BITS_PER_TICK
        if not self._flooded:
            return
        self._note_hit(Kind.FLOOD)
        self._bits_left = round((1.0 - share) * BUS_BITS_PER_TICK)
        for _ in range(int(share * BUS_BITS_PER_TICK) // worst_case_bits(len(BABBLE.data))):
            self._ready.append(BABBLE)
            if not self.robot_is_away:
                self._bus.send(BABBLE)

    def _deliver_waiting(self) -> None:
        for lane in (self._to_robot, self._from_robot):
            waiting = list(lane.queue)
            lane.queue.clear()
            for message in waiting:
                self._transport(lane, message)
            due = [message for tick, message in lane.late if self._tick is None or tick <= self._tick]
            lane.late = [] if self._tick is None else [entry for entry in lane.late if entry[0] > self._tick]
            for message in due:
                self._transport(lane, message)
            if self._tick is None and lane.overtaken is not None:
                self._transport(lane, lane.overtaken)
                lane.overtaken = None

    # ---- a frame

    def _pass(self, lane: _Lane, message: can.Message) -> None:
        """Lead one frame through the plan and on to its end of the lane."""
        if not self._active:
            self._forward(lane, [message])
            return
        copies = 1
        for fault in self._faults_of(lane, message):
            self._note_hit(fault.kind)
            match fault.kind:
                case Kind.DROP:
                    return
                case Kind.DELAY:
                    assert self._tick is not None  # without a tick no fault acts
                    lane.late.append((self._tick + fault.amount, message))
                    return
                case Kind.REORDER if lane.overtaken is None:
                    lane.overtaken = message
                    return
                case Kind.REPEAT:
                    copies += fault.amount
                case Kind.CORRUPT:
                    message = self._damaged(message, fault.amount)
        self._forward(lane, copies * [message])

    def _faults_of(self, lane: _Lane, message: can.Message) -> Iterator[Fault]:
        known = self._codec.of_id(message.arbitration_id)
        name = "" if known is None else known.name
        for fault in self._active:
            meets = fault.kind in OF_A_FRAME and fault.way in (lane.way, Way.BOTH)
            if meets and (not fault.messages or name in fault.messages) and self._random.random() < fault.rate:
                yield fault

    def _damaged(self, message: can.Message, bits: int) -> can.Message:
        """Return a copy with so many bits of its payload flipped, each another one."""
        data = bytearray(message.data)
        for bit in self._random.sample(range(8 * len(data)), min(bits, 8 * len(data))):
            data[bit // 8] ^= 1 << bit % 8
        return can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=data)

    def _forward(self, lane: _Lane, messages: list[can.Message]) -> None:
        if lane.overtaken is not None:
            messages = [*messages, lane.overtaken]
            lane.overtaken = None
        for message in messages:
            self._transport(lane, message)

    def _transport(self, lane: _Lane, message: can.Message) -> None:
        """Bring a frame to its end of the lane, now or when bus and robot take it."""
        if self._dead:
            return
        if self._paused:
            if len(lane.queue) < PAUSED_FRAMES:
                lane.queue.append(message)
            return
        if self._flooded:
            self._bits_left -= worst_case_bits(len(message.data))
            if self._bits_left < 0:
                self._wait_for_bus(lane, message)
                return
        lane.deliver(message)

    def _wait_for_bus(self, lane: _Lane, message: can.Message) -> None:
        if len(lane.queue) < QUEUE_FRAMES:
            lane.queue.append(message)
        else:
            self.overflowed += 1

    def _give_robot(self, message: can.Message) -> None:
        if self._watch is not None:
            self._watch(True, message)
        self._bus.send(message)

    # ---- python-can's side

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Send a frame towards the robot."""
        self._pass(self._to_robot, msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = self._next_ready()
        if message is None and not self.robot_is_away:
            self._collect(0.0)
            if not self._ready and timeout != 0.0 and self._tick is None:
                self._collect(timeout)
            message = self._next_ready()
        return message, True

    def _next_ready(self) -> can.Message | None:
        while self._ready:
            message = self._ready.popleft()
            if self._matches_filters(message):
                return message
        return None

    def _collect(self, timeout: float | None) -> None:
        """Take what the robot has sent; waits for its first frame only."""
        while (message := self._bus.recv(timeout)) is not None:
            timeout = 0.0
            if self._watch is not None:
                self._watch(False, message)
            self._pass(self._from_robot, message)

    def shutdown(self) -> None:
        """Shut both buses down."""
        super().shutdown()
        if not self._dead:
            self._bus.shutdown()
