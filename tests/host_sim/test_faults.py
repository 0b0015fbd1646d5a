"""A bus that fails by plan, around a bus that only remembers."""

import random
from collections import deque

import can
import pytest

from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.faults import QUEUE_FRAMES, Fault, FaultPlan, FaultyBus, Kind, Way

CODEC = Codec()
FRAMES = 3000


class Ends(can.BusABC):
    """The robot's end of a bus: what reached it, and what it has to say."""

    def __init__(self) -> None:
        self.got: list[can.Message] = []
        self.says: deque[can.Message] = deque()
        self.is_shut = False
        super().__init__(channel="ends")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        self.got.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        return (self.says.popleft() if self.says else None), False

    def shutdown(self) -> None:
        self.is_shut = True
        super().shutdown()


def frame(name: str, number: int = 0) -> can.Message:
    length = CODEC[name].length
    data = number.to_bytes(4, "little").ljust(length, b"\x5a")
    return can.Message(arbitration_id=CODEC[name].arbitration_id, is_extended_id=False, data=data)


def numbers(messages: list[can.Message]) -> list[int]:
    return [int.from_bytes(message.data[:4], "little") for message in messages]


def faulty(*faults: Fault, seed: int = 1) -> tuple[FaultyBus, Ends]:
    ends = Ends()
    bus = FaultyBus(ends, CODEC, FaultPlan(faults, seed))
    return bus, ends


def sent_a_tick(bus: FaultyBus, ticks: int, name: str = "SYNC") -> None:
    """Send a frame a tick, its number in it."""
    for tick in range(ticks):
        bus.begin_tick(tick)
        bus.send(frame(name, tick))


def test_without_a_plan_every_frame_passes_both_ways_unchanged() -> None:
    bus, ends = faulty()
    ends.says.extend(frame("TORQUE", number) for number in range(5))
    with bus:
        sent_a_tick(bus, 5)
        answers = [bus.recv(0.0) for _ in range(6)]
    assert numbers(ends.got) == list(range(5))
    assert numbers([answer for answer in answers if answer is not None]) == list(range(5))
    assert answers[5] is None
    assert ends.is_shut


def test_drop_takes_the_share_it_names_and_the_same_frames_for_the_same_seed() -> None:
    runs = []
    for seed in (1, 1, 2):
        bus, ends = faulty(Fault(Kind.DROP, rate=0.3), seed=seed)
        with bus:
            sent_a_tick(bus, FRAMES)
        runs.append(numbers(ends.got))
    # Four standard deviations of a binomial count are 100.
    assert abs(len(runs[0]) - 0.7 * FRAMES) < 100
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_fault_meets_only_its_messages_its_window_and_its_direction() -> None:
    bus, ends = faulty(Fault(Kind.DROP, ("SYNC",), Way.TO_ROBOT, first_tick=2, ticks=2))
    with bus:
        for tick in range(6):
            bus.begin_tick(tick)
            bus.send(frame("POSE", 100 + tick))
            bus.send(frame("SYNC", tick))
            ends.says.append(frame("TORQUE", tick))
            assert bus.recv(0.0) is not None
    assert [number for number in numbers(ends.got) if number < 100] == [0, 1, 4, 5]
    assert [number for number in numbers(ends.got) if number >= 100] == list(range(100, 106))
    assert bus.first_hit_tick == 2


def test_delay_brings_a_frame_so_many_ticks_later() -> None:
    bus, ends = faulty(Fault(Kind.DELAY, ticks=1, amount=3))
    with bus:
        sent_a_tick(bus, 6)
    assert numbers(ends.got) == [1, 2, 0, 3, 4, 5]


def test_repeat_gives_further_copies() -> None:
    bus, ends = faulty(Fault(Kind.REPEAT, ticks=1, amount=2))
    with bus:
        sent_a_tick(bus, 2)
    assert numbers(ends.got) == [0, 0, 0, 1]


def test_reorder_lets_the_next_frame_pass_first_and_loses_none() -> None:
    bus, ends = faulty(Fault(Kind.REORDER, rate=0.5))
    with bus:
        sent_a_tick(bus, 100)
        bus.end()
    got = numbers(ends.got)
    assert sorted(got) == list(range(100))
    assert got != sorted(got)
    assert max(abs(place - number) for place, number in enumerate(got)) == 1


@pytest.mark.parametrize("bits", [1, 3, 48])
def test_corrupt_flips_exactly_so_many_bits_of_the_payload(bits: int) -> None:
    bus, ends = faulty(Fault(Kind.CORRUPT, amount=bits))
    with bus:
        sent_a_tick(bus, 50)
    for number, message in enumerate(ends.got):
        before = int.from_bytes(frame("SYNC", number).data, "little")
        assert (before ^ int.from_bytes(message.data, "little")).bit_count() == bits
        assert message.arbitration_id == CODEC["SYNC"].arbitration_id


def test_flood_of_the_whole_bus_lets_nothing_pass_until_its_end_but_what_waits_in_the_queue() -> None:
    bus, ends = faulty(Fault(Kind.FLOOD, ticks=100))
    with bus:
        sent_a_tick(bus, 100)
        babble = [message for message in ends.got if message.arbitration_id == 0]
        assert len(babble) == len(ends.got) == 100 * (1000 // 135)  # a frame of 8 bytes is 135 bits at the worst
        ends.got.clear()
        bus.begin_tick(100)
    assert numbers(ends.got) == list(range(QUEUE_FRAMES))
    assert bus.overflowed == 100 - QUEUE_FRAMES


def test_flood_of_a_part_lets_through_what_fits() -> None:
    # A SYNC takes 125 bits: of the 500 that are left, four fit.
    bus, ends = faulty(Fault(Kind.FLOOD, rate=0.5))
    with bus:
        bus.begin_tick(0)
        for number in range(6):
            bus.send(frame("SYNC", number))
        assert numbers(ends.got)[-4:] == [0, 1, 2, 3]
        ends.got.clear()
        bus.begin_tick(1)
    assert numbers(ends.got)[-2:] == [4, 5]


def test_paused_robot_gets_everything_in_order_when_it_goes_on() -> None:
    bus, ends = faulty(Fault(Kind.PAUSE, first_tick=1, ticks=3))
    with bus:
        ends.says.append(frame("TORQUE", 7))
        sent_a_tick(bus, 4)
        assert numbers(ends.got) == [0]
        assert bus.robot_is_away
        assert bus.recv(0.0) is None
        bus.begin_tick(4)
        assert numbers(ends.got) == [0, 1, 2, 3]
        assert bus.recv(0.0) is not None


def test_restart_loses_what_is_under_way_and_puts_another_robot_there() -> None:
    old, new = Ends(), Ends()
    plan = FaultPlan((Fault(Kind.RESTART, first_tick=1, ticks=2),))
    with FaultyBus(old, CODEC, plan, revive=lambda: new) as bus:
        sent_a_tick(bus, 4)
    assert numbers(old.got) == [0]
    assert old.is_shut
    assert numbers(new.got) == [3]
    assert new.is_shut


def test_filters_of_the_host_hold_and_pass_over_a_babbling_node() -> None:
    bus, ends = faulty(Fault(Kind.FLOOD, rate=0.5))
    with bus:
        bus.set_filters([{"can_id": CODEC["TORQUE"].arbitration_id, "can_mask": 0x7FF, "extended": False}])
        bus.begin_tick(0)
        ends.says.append(frame("TORQUE", 9))
        message = bus.recv(0.0)
    assert message is not None
    assert numbers([message]) == [9]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"rate": 1.5}, r"rate = 1.5 must be 0 … 1"),
        ({"ticks": 0}, "ticks = 0 and amount = 1 at least 1"),
        ({"messages": ("SINK",)}, "no message 'SINK'"),
        ({"kind": Kind.RESTART}, "cannot restart"),
    ],
)
def test_plan_without_sense_is_refused_by_name(change: dict[str, object], why: str) -> None:
    with Ends() as ends, pytest.raises(OmnibotError, match=why):
        FaultyBus(ends, CODEC, FaultPlan((Fault(**{"kind": Kind.DROP, **change}),)))  # type: ignore[arg-type]


def test_random_bytes_of_any_length_pass_through_damage() -> None:
    chance = random.Random(3)
    bus, ends = faulty(Fault(Kind.CORRUPT, amount=8), Fault(Kind.REORDER, rate=0.2))
    with bus:
        bus.begin_tick(0)
        for length in range(9):
            bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False, data=chance.randbytes(length)))
        bus.end()
    assert sorted(len(message.data) for message in ends.got) == list(range(9))
