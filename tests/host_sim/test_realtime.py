"""The run by the clock, on a clock of our own: the firmware in-process, its timer and the simulator in made-up time."""

import base64
import math
from typing import Any

import can
import numpy as np
import pytest

from host_sim.codec import Codec
from host_sim.drive import Drive, Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link, RefusedError
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.realtime import drive_in_real_time, histogram, summary
from host_sim.report.run import timing_figure
from host_sim.robot import load_robot
from host_sim.run import prepare, set_up
from host_sim.scenario import Scenario
from host_sim.trace import Trace

ROBOT = load_robot()
PERIOD_S = ROBOT.control_period_s
PATH = PathRequest("rhombus", 0.5, "rounded", 2.0, 0.6, 0.3)
TICKS = 601


# What SYNC carries at tick 0 of a drive: 50 of the warm-up, one before START and one after.
FIRST_SYNC = 52


class ClockedBus(InprocBus):
    """A bus in a time that passes only while somebody waits: the firmware's timer goes on through the wait.

    ``delay_s`` is how long after its tick the firmware's answers are on the bus; ``stalls`` for how long the
    simulator sleeps, in s, when it sends the SYNC of a tick; ``deaf`` from which of the firmware's ticks on none comes.
    """

    def __init__(self, delay_s: float = 1e-4, stalls: dict[int, float] | None = None, deaf: float = math.inf) -> None:
        super().__init__()
        self.now_s, self.next_tick_s = 100.0, 100.0 + 0.3 * PERIOD_S
        self.delay_s, self.stalls, self.deaf = delay_s, stalls or {}, deaf
        self.ticks = 0
        self.waiting: list[tuple[float, can.Message]] = []

    def clock(self) -> float:
        return self.now_s

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        super().send(msg, timeout)
        self._collect(self.now_s)
        if msg.arbitration_id == 64:
            tick = int.from_bytes(msg.data[:4], "little")
            self.pass_time(self.stalls.pop(tick - FIRST_SYNC, 0.0))

    def pass_time(self, time_s: float) -> None:
        until_s = self.now_s + time_s
        while self.next_tick_s <= until_s:
            if self.ticks < self.deaf:
                self.tick()
            self.ticks += 1
            self._collect(self.next_tick_s + self.delay_s)
            self.next_tick_s += PERIOD_S
        self.now_s = until_s

    def _collect(self, ready_s: float) -> None:
        while (frame := super()._recv_internal(0.0)[0]) is not None:
            self.waiting.append((ready_s, frame))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        until_s = self.now_s + (timeout or 0.0)
        while not self.waiting or self.waiting[0][0] > self.now_s:
            ready_s = self.waiting[0][0] if self.waiting else math.inf
            wake_s = min(ready_s, self.next_tick_s, until_s)
            self.pass_time(max(wake_s - self.now_s, 0.0))
            if self.now_s >= until_s and (not self.waiting or self.waiting[0][0] > self.now_s):
                return None, False
        return self.waiting.pop(0)[1], False


def plant() -> Plant:
    made = Plant(ROBOT, Scenario(PATH).traction_of(ROBOT))
    made.reset(*start_state(ROBOT, plan(PATH)))
    return made


def by_the_clock(
    monkeypatch: pytest.MonkeyPatch,
    bus: ClockedBus,
    parameters: dict[str, str] | None = None,
    driven_plant: Plant | None = None,
) -> Drive:
    for clock in ("host_sim.realtime.time.perf_counter", "host_sim.link.time.monotonic", "can.bus.time"):
        monkeypatch.setattr(clock, bus.clock)
    scenario = Scenario(PATH, time="realtime", parameters=parameters or {})
    trajectory = plan(PATH)
    with bus:
        link = Link(bus, Codec())
        set_up(link, ROBOT, scenario, trajectory)
        return drive_in_real_time(link, driven_plant or plant(), ROBOT, trajectory)


@pytest.fixture(scope="module")
def lockstep() -> Trace:
    trajectory = plan(PATH)
    with InprocBus() as bus:
        link = Link(bus, Codec())
        prepare(link, ROBOT, Scenario(PATH), trajectory)
        return drive(link, plant(), ROBOT, trajectory).trace


def test_in_time_the_trace_is_that_of_lockstep(monkeypatch: pytest.MonkeyPatch, lockstep: Trace) -> None:
    driven = by_the_clock(monkeypatch, ClockedBus())
    assert (driven.status, driven.reason) == (Status.COMPLETED, "")
    assert len(driven.trace) == TICKS
    for name in ("pose", "body_twist", "wheel_speed", "torque", "mu", "point", "reference_point"):
        np.testing.assert_array_equal(driven.trace.column(name), lockstep.column(name), err_msg=name)
    timing = driven.timing.as_dict(0.6)
    assert timing["steps"] == TICKS
    assert timing["deadline_misses"] == timing["plant_skipped_instants"] == 0
    assert timing["firmware_overruns"] is None  # this firmware measures nothing


def test_round_trip_is_half_a_period_and_the_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    timing = by_the_clock(monkeypatch, ClockedBus(delay_s=2e-4)).timing.as_dict(0.6)
    # The plant's phase is half a period before the torque comes.
    assert timing["round_trip_us"]["mean"] == pytest.approx(500.0, abs=30.0)
    assert timing["torque_jitter_us"]["max"] == pytest.approx(0.0, abs=1e-3)


def test_answers_that_come_too_late_are_counted_and_act_late(monkeypatch: pytest.MonkeyPatch, lockstep: Trace) -> None:
    driven = by_the_clock(monkeypatch, ClockedBus(stalls={100: 0.7 * PERIOD_S}))
    assert driven.status is Status.COMPLETED
    # Asleep over its next instant, the simulator wakes within the period after it: an older torque for one of them.
    assert driven.timing.as_dict(0.6)["deadline_misses"] == 0
    np.testing.assert_array_equal(driven.trace.pose, lockstep.pose)


def test_simulator_asleep_skips_periods_and_catches_up(monkeypatch: pytest.MonkeyPatch) -> None:
    driven = by_the_clock(monkeypatch, ClockedBus(stalls={200: 4.2 * PERIOD_S}), {"wheel_speed_timeout_s": "0.1"})
    timing = driven.timing.as_dict(0.6)
    assert driven.status is Status.COMPLETED
    assert timing["plant_skipped_instants"] == 3
    assert timing["deadline_misses"] == 3
    assert timing["plant_lateness_us"]["max"] == pytest.approx(3200.0, abs=50.0)
    assert timing["real_time_factor"] == pytest.approx(0.6 / (0.601 + 0.05), rel=0.05)  # the warm-up included
    assert np.abs(driven.trace.point - driven.trace.reference_point).max() < 5e-3


def test_simulator_asleep_for_longer_than_wheel_speeds_may_be_old_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    driven = by_the_clock(monkeypatch, ClockedBus(stalls={200: 8 * PERIOD_S}))
    assert driven.status is Status.FAULT
    assert "STALE_WHEEL_SPEED" in driven.reason
    assert 200 <= len(driven.trace) <= 202


class InterruptedBus(ClockedBus):
    """Its user presses Ctrl-C as the SYNC of a tick goes out; ``mode`` is that of the firmware's newest TORQUE."""

    mode = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        super().send(msg, timeout)
        if msg.arbitration_id == 64 and int.from_bytes(msg.data[:4], "little") == FIRST_SYNC + 300:
            raise KeyboardInterrupt

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message, filtered = super()._recv_internal(timeout)
        if message is not None and message.arbitration_id == 80:
            self.mode = message.data[6] >> 4
        return message, filtered


def test_ctrl_c_keeps_the_trace_and_brings_the_robot_to_rest(monkeypatch: pytest.MonkeyPatch, lockstep: Trace) -> None:
    bus, driven_plant = InterruptedBus(), plant()
    driven = by_the_clock(monkeypatch, bus, driven_plant=driven_plant)
    assert (driven.status, driven.reason) == (Status.INTERRUPTED, "stopped by Ctrl-C at 0.300 s")
    np.testing.assert_array_equal(driven.trace.pose, lockstep.pose[:300])
    assert np.hypot(*driven.trace.body_twist[-1, :2]) > 0.2
    assert bus.mode == Codec()["STATUS"].choices["mode"]["IDLE"], "a host that goes while the robot brakes is a fault"
    assert np.abs(driven_plant.body_twist).max() < 1e-3


def test_firmware_whose_timer_stops_ends_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    driven = by_the_clock(monkeypatch, ClockedBus(deaf=10))
    assert driven.status is Status.TIMEOUT
    assert "no TORQUE while TRACKING" in driven.reason


def test_plant_follows_a_firmware_with_a_faster_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = ClockedBus()
    monkeypatch.setattr("test_realtime.PERIOD_S", PERIOD_S * (1.0 - 1e-3))
    timing = by_the_clock(monkeypatch, bus).timing.as_dict(0.6)
    assert timing["deadline_misses"] == 0  # without following, the phase would slip by 0.6 of a period
    assert timing["round_trip_us"]["mean"] == pytest.approx(500.0, abs=150.0)


def test_simulator_that_is_often_late_does_not_stretch_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("test_realtime.PATH", PathRequest("rhombus", 0.5, "rounded", 2.0, 3.0, 0.3))
    late_s = PERIOD_S * np.random.default_rng(1).uniform(0.0, 1.2, 3001)
    driven = by_the_clock(monkeypatch, ClockedBus(stalls=dict(enumerate(late_s.tolist()))))
    assert driven.status is Status.COMPLETED
    # Taken for the firmware's clock, the late answers would leave the plant 1.2 mm behind its reference.
    assert np.abs(driven.trace.point - driven.trace.reference_point).max() < 1e-4


def test_realtime_needs_a_firmware_that_can(monkeypatch: pytest.MonkeyPatch) -> None:
    with InprocBus() as bus:
        link = Link(bus, Codec())
        monkeypatch.setattr(link, "command", lambda operation: _refuse() if operation == "USE_REALTIME" else None)
        with pytest.raises(OmnibotError, match="omnibot-sil --can INTERFACE --time realtime"):
            link.hello("realtime")


def _refuse() -> None:
    raise RefusedError("the firmware refused USE_REALTIME: UNABLE (mode IDLE)")


# ---- what is made of times


def test_summary_of_nothing_is_none() -> None:
    assert summary([]) == {"min": None, "mean": None, "p99": None, "max": None}
    assert summary([1.0, 2.0, 6.0])["mean"] == 3.0


@pytest.mark.parametrize(
    ("times", "counts"),
    [([], [0]), ([0.0, 19.9, 20.0, 61.0], [2, 1, 0, 1]), ([-1.0], [1]), ([1e9], [0] * 149 + [1])],
)
def test_histogram_counts_each_time_once(times: list[float], counts: list[int]) -> None:
    assert histogram(times) == {"class_us": 20.0, "counts": counts}


def test_histograms_are_drawn_even_when_empty() -> None:
    histograms: dict[str, Any] = {"round_trip_us": histogram([1.0, 300.0]), "torque_jitter_us": histogram([])}
    panels = timing_figure(histograms).panels
    assert [panel.title for panel in panels] == ["Round trip (ticks)", "Torque jitter (ticks)"]
    middles, counts = (
        np.frombuffer(base64.b64decode(panels[0].traces[0][axis]["bdata"]), dtype="<f4") for axis in "xy"
    )
    assert {float(x): float(y) for x, y in zip(middles, counts, strict=True) if y} == {10.0: 1.0, 310.0: 1.0}
