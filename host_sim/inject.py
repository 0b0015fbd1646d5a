"""What the firmware does when its bus fails: drives in-process over a faulty bus, and the table made of them.

The plant does not wait, as it would not in the world: a tick passes whether or not its frames got through, and the
wheels keep the newest torque that came. What the firmware sends is judged at its own end of the bus.
"""

import functools
import math
import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Self

import can
import numpy as np

from host_sim.codec import Codec, WireError
from host_sim.drive import DIVERGED_ERROR_M, start_state, tracked_point, wrapped_pose
from host_sim.faults import Fault, FaultPlan, FaultyBus, Kind, Way
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.pool import in_processes
from host_sim.robot import Robot, load_robot
from host_sim.run import prepare, set_up
from host_sim.scenario import PACES, Scenario
from host_sim.sweep import corner_path
from host_sim.trajectory import Trajectory

SPEED_M_PER_S = 0.5
CORNER_TICK = 2000  # corner_path puts the corner there
COAST_TICKS = 500  # watched after the torque is off
AGAIN_TICKS = 500  # driven without faults afterwards
AGAIN_ERROR_M = 1e-3
STOP_EVERY_TICKS = 10  # a host that wants a stop says so until it has it

REST_TICKS_MAX = 4000  # after a STOP: braking takes 2 s at most, and 0.5 s more
DRIVING = ("TRACKING", "STOPPING")

SENSORS = ("POSE", "WHEEL_SPEED")
UNEXPLAINED = "unexplained"


class Watch:
    """Sees what the firmware gets and gives, at its own end of the bus, and holds it against what it must do."""

    def __init__(self, codec: Codec, torque_bound_Nm: float) -> None:
        self._codec = codec
        self._torque, self._status = codec["TORQUE"], codec["STATUS"]
        self._command_id, self._hello_id = codec["COMMAND"].arbitration_id, codec["HELLO"].arbitration_id
        self._bound_Nm = torque_bound_Nm + 0.5 * self._torque.fields[0].unit_per_step
        self.begin()

    def begin(self) -> None:
        """Start to watch a drive."""
        self.mode = "IDLE"
        self.fault = "NONE"
        self.dropped = self.missed = 0
        self.max_torque_Nm = 0.0
        self.left_because = ""
        self.violations: list[str] = []
        self._asked = ""  # since the last torque of a driving robot: what ends a drive without a fault

    def __call__(self, to_robot: bool, message: can.Message) -> None:
        """Take note of a frame."""
        data = bytes(message.data)
        if to_robot:
            self._note_request(message.arbitration_id, data)
        elif message.arbitration_id == self._torque.arbitration_id:
            *torque, _, mode = self._torque.unpack(data)
            self._note_mode(self._torque.label("mode", mode))
            self._judge(torque)
        elif message.arbitration_id == self._status.arbitration_id:
            self._note_status(self._status.named(data))

    def _note_request(self, arbitration_id: int, data: bytes) -> None:
        try:
            if arbitration_id == self._hello_id:
                self._asked = "new host"
            elif arbitration_id == self._command_id:
                command = self._codec["COMMAND"]
                self._asked = command.label("operation", command.unpack(data)[0])
        except WireError:
            return  # the firmware drops it, too

    def _note_status(self, status: dict[str, float]) -> None:
        self.fault = self._status.label("fault", status["fault"])
        self.dropped, self.missed = int(status["dropped_frames"]), int(status["missed_ticks"])
        self._note_mode(self._status.label("mode", status["mode"]))
        # The STATUS of the change itself may find no room in the firmware's outbox.
        if self.left_because == UNEXPLAINED:
            self.left_because = self._cause()

    def _note_mode(self, mode: str) -> None:
        if self.mode == "TRACKING" and mode != "TRACKING":
            self.left_because = self._cause()
        elif mode == "TRACKING":
            self._asked = ""
        self.mode = mode

    def _judge(self, torque: list[float]) -> None:
        largest = max(map(abs, torque))
        self.max_torque_Nm = max(self.max_torque_Nm, largest)
        if not all(abs(value) <= self._bound_Nm for value in torque):  # NaN is beyond it, too
            self.violations.append(f"torque {torque} beyond its bound")
        if self.mode not in DRIVING and any(torque):
            self.violations.append(f"torque {torque} in mode {self.mode}")

    def _cause(self) -> str:
        """Return why the firmware no longer tracks, from what is on the bus alone."""
        return f"fault {self.fault}" if self.fault != "NONE" else self._asked or UNEXPLAINED

    def note_death(self) -> None:
        """Know that the firmware is gone: what comes next is from another one."""
        if self.mode in DRIVING:
            self.left_because = self.left_because or "restarted"
        self.mode = "IDLE"


@dataclass
class Outcome:
    """What came of a drive.

    Attributes
    ----------
    end
        ``completed``, or why the firmware stopped driving.
    firmware_ticks
        From the first frame that met a fault, or the host's wish to stop, to the firmware's leaving TRACKING; None: it
        drove on.
    wheels_ticks
        To the first tick with no torque at the wheels, braking over: the host holds the newest TORQUE that came.
    distance_m
        That the tracked point travelled until then.
    max_torque_Nm, max_wheel_torque_Nm
        That the firmware asked for, and that the wheels were told: a damaged TORQUE may pass its CRC.
    speed_left_m_per_s
        Of the body, 0.5 s later: nothing brakes it then.
    """

    end: str = "completed"
    mode: str = ""
    fault: str = "NONE"
    dropped: int = 0
    missed: int = 0
    hits: int = 0
    firmware_ticks: int | None = None
    wheels_ticks: int | None = None
    max_torque_Nm: float = 0.0
    max_wheel_torque_Nm: float = 0.0
    distance_m: float | None = None
    speed_left_m_per_s: float | None = None
    max_error_m: float = 0.0
    violations: list[str] = field(default_factory=list)
    ticks: int = 0


class Session:
    """The firmware in-process behind a faulty bus, the host's link to it, and the plant at its other end.

    Parameters
    ----------
    time
        ``lockstep`` or ``realtime``: what paces the firmware. Its timer is ours here: one tick of it a period.
    """

    def __init__(self, time: str = "lockstep") -> None:
        self.robot = load_robot()
        self.codec = Codec()
        self.watch = Watch(self.codec, self.robot.parameter("torque_bound_Nm").default)
        self.bus = FaultyBus(self._new_firmware(), self.codec, revive=self._new_firmware, watch=self.watch)
        self.link = Link(self.bus, self.codec)
        self.time = time

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bus.shutdown()

    def _new_firmware(self) -> can.BusABC:
        self.firmware = InprocBus()
        return self.firmware

    def drive(self, request: PathRequest, faults: FaultPlan, ticks: int | None = None, stop_at: int = -1) -> Outcome:
        """Set the firmware up on a good bus and drive while the plan happens, until the path or the motion ends.

        Parameters
        ----------
        ticks
            Drive no longer than this.
        stop_at
            The host asks for a stop from this tick on.
        """
        trajectory = _planned(request)
        driver = _Drive(self, trajectory, ticks)
        self.bus.use(faults)
        try:
            driver.run(stop_at)
        finally:
            self.bus.end()
        if self.watch.mode == "FAULT":
            self.link.command("STOP")  # answered by STATUS, which names the fault
        outcome = driver.summary()
        driver.come_to_rest()
        return outcome

    def drives_again(self, request: PathRequest) -> bool:
        """Tell whether the robot starts again after all that, and follows its path as if nothing had been."""
        outcome = self.drive(request, FaultPlan(), AGAIN_TICKS)
        return outcome.end == "completed" and outcome.max_error_m < AGAIN_ERROR_M and not outcome.violations


class _Drive:
    """The state of one drive: see ``Session.drive``."""

    def __init__(self, session: Session, trajectory: Trajectory, ticks: int | None) -> None:
        self.session, self.link, self.bus, self.watch = session, session.link, session.bus, session.watch
        self.robot: Robot = session.robot
        self.period_s = self.robot.control_period_s
        whole = round(trajectory.duration_us * 1e-6 / self.period_s) + 1
        self.ticks = whole if ticks is None else min(ticks, whole)
        self.reference = trajectory.rounded().evaluate(self.period_s * np.arange(self.ticks), derivatives=0)[:, 0]
        scenario = Scenario(PathRequest("line", SPEED_M_PER_S), time=session.time)
        self.plant = Plant(self.robot, scenario.traction_of(self.robot), scenario.speed_length_m)
        self.plant.reset(*start_state(self.robot, trajectory))
        self.torque = [0.0, 0.0, 0.0]  # at the wheels
        self.outcome = Outcome()
        self.off_tick: int | None = None
        self.distance_m = 0.0
        self.begin(scenario, trajectory)

    def begin(self, scenario: Scenario, trajectory: Trajectory) -> None:
        """Bring the firmware to TRACKING."""
        if self.session.time == "lockstep":
            prepare(self.link, self.robot, scenario, trajectory)
        else:
            set_up(self.link, self.robot, scenario, trajectory)
            self.send(-1)  # it must know where it is before it drives
            self.session.firmware.tick()
            self.link.start()
        self.watch.begin()
        self.watch.mode = "TRACKING"  # command() saw it

    def send(self, tick: int) -> None:
        """Send the sensors and the SYNC of a tick."""
        speed = [float(value) for value in self.plant.wheel_speed]
        self.link.send_sensors(tick & 0xFFFFFFFF, wrapped_pose(self.plant), speed)
        self.link.send_sync(tick & 0xFFFFFFFF)

    def run(self, stop_at: int) -> None:
        """Drive to the end."""
        point = tracked_point(self.plant, self.robot)
        for tick in range(self.ticks + REST_TICKS_MAX):
            if tick >= self.ticks and self.watch.mode != "STOPPING":
                break
            self.outcome.ticks = tick + 1
            self.exchange(tick, stop_at)
            self.note_reaction(tick, stop_at)
            if self.off_tick is not None and tick >= self.off_tick + COAST_TICKS:
                break
            self.plant.step(np.array(self.torque), self.period_s)
            before, point = point, tracked_point(self.plant, self.robot)
            self.distance_m += math.dist(before, point)
            if self.is_lost(tick, point):
                break

    def note_reaction(self, tick: int, stop_at: int) -> None:
        """Take down when firmware and wheels react to what began, and how far the robot came until then."""
        since = stop_at if stop_at >= 0 else self.bus.first_hit_tick
        if since is None or tick <= since:
            self.distance_m = 0.0
        if self.watch.mode != "TRACKING" and self.outcome.firmware_ticks is None and since is not None:
            self.outcome.firmware_ticks = tick - since
        if self.off_tick is None and self.watch.mode not in DRIVING and not any(self.torque):
            self.off_tick, self.outcome.distance_m = tick, self.distance_m
            self.outcome.wheels_ticks = None if since is None else tick - since

    def come_to_rest(self) -> None:
        """Have a robot that still drives stop, on the good bus, so that the next drive finds it at rest."""
        if self.watch.mode not in DRIVING:
            return
        self.link.command("STOP")
        for tick in range(self.outcome.ticks, self.outcome.ticks + REST_TICKS_MAX):
            self.step(tick)
            if self.watch.mode not in DRIVING:
                return
            self.plant.step(np.array(self.torque), self.period_s)
        self.watch.violations.append(f"still {self.watch.mode} {REST_TICKS_MAX} ticks after STOP")

    def exchange(self, tick: int, stop_at: int) -> None:
        """One tick over the bus, both ways, and a host that may ask for a stop."""
        self.bus.begin_tick(tick)
        if self.bus.robot_is_dead:
            self.watch.note_death()
            self.torque = [0.0, 0.0, 0.0]  # a processor in reset holds its bridges off
        if 0 <= stop_at <= tick and (tick - stop_at) % STOP_EVERY_TICKS == 0 and self.off_tick is None:
            self.link.send("COMMAND", self.session.codec["COMMAND"].choices["operation"]["STOP"], tick // 10 & 0xF, 0)
        self.step(tick)

    def step(self, tick: int) -> None:
        """One tick over the bus, both ways."""
        self.send(tick)
        if self.session.time == "realtime" and not self.bus.robot_is_away:
            self.session.firmware.tick()
        while (heard := self.link.hear(0.0)) is not None:
            name, values = heard
            if name == "TORQUE":
                self.torque = [values["wheel1_Nm"], values["wheel2_Nm"], values["wheel3_Nm"]]
                self.outcome.max_wheel_torque_Nm = max(self.outcome.max_wheel_torque_Nm, *map(abs, self.torque))

    def is_lost(self, tick: int, point: tuple[float, float]) -> bool:
        """Note the error of a driving robot; tell whether there is no sense in going on."""
        if self.off_tick is None and self.watch.mode == "TRACKING":
            reference = self.reference[min(tick + 1, self.ticks - 1)]
            error_m = math.dist(point, (reference[0], reference[1]))
            self.outcome.max_error_m = max(self.outcome.max_error_m, error_m)
        return self.plant.diverged or self.outcome.max_error_m > DIVERGED_ERROR_M

    def summary(self) -> Outcome:
        """Return what came of it."""
        outcome, watch = self.outcome, self.watch
        if watch.left_because:
            outcome.end = watch.left_because
        elif self.plant.diverged or outcome.max_error_m > DIVERGED_ERROR_M:
            outcome.end = "diverged"
        elif watch.mode != "TRACKING":
            outcome.end = UNEXPLAINED
        outcome.mode, outcome.fault, outcome.violations = watch.mode, watch.fault, watch.violations
        outcome.dropped, outcome.missed, outcome.max_torque_Nm = watch.dropped, watch.missed, watch.max_torque_Nm
        outcome.hits = sum(self.bus.hits.values())
        if self.off_tick is not None:
            outcome.speed_left_m_per_s = float(np.linalg.norm(self.plant.body_twist[:2]))
        return outcome


_planned = functools.lru_cache(maxsize=32)(plan)


# ---- the table


@dataclass(frozen=True)
class FaultCase:
    """One row of the table."""

    name: str
    faults: tuple[Fault, ...] = ()
    stop_at: int = -1
    time: str = "lockstep"
    seed: int = 0


def _gap(ticks: int, *messages: str) -> tuple[Fault, ...]:
    return (Fault(Kind.DROP, messages, first_tick=CORNER_TICK - 10, ticks=ticks),)


def _some(kind: Kind, rate: float, *messages: str, amount: int = 1, way: Way = Way.BOTH) -> tuple[Fault, ...]:
    """For three seconds around the corner."""
    return (Fault(kind, messages, way, CORNER_TICK - 1500, 3000, rate, amount),)


def _spell(kind: Kind, ticks: int, rate: float = 1.0) -> tuple[Fault, ...]:
    return (Fault(kind, first_tick=CORNER_TICK - 10, ticks=ticks, rate=rate),)


SCENARIOS: dict[str, tuple[Fault, ...]] = {
    "nothing": (),
    "30 % of all frames lost": _some(Kind.DROP, 0.3),
    "30 % of frames to the robot lost": _some(Kind.DROP, 0.3, way=Way.TO_ROBOT),
    "30 % of frames from the robot lost": _some(Kind.DROP, 0.3, way=Way.FROM_ROBOT),
    "30 % of sensor frames lost": _some(Kind.DROP, 0.3, *SENSORS),
    "50 ms without sensors": _gap(50, *SENSORS),
    "50 ms without poses": _gap(50, "POSE"),
    "600 ms without poses": _gap(600, "POSE"),
    "50 ms without wheel speeds": _gap(50, "WHEEL_SPEED"),
    "50 ms without SYNC": _gap(50, "SYNC"),
    "5 ms without anything": _gap(5),
    "50 ms without anything": _gap(50),
    "200 ms without anything": _gap(200),
    "flood of 30 % for 1 s": _spell(Kind.FLOOD, 1000, 0.3),
    "flood of 80 % for 1 s": _spell(Kind.FLOOD, 1000, 0.8),
    "flood of 100 % for 50 ms": _spell(Kind.FLOOD, 50),
    "flood of 100 % for 1 s": _spell(Kind.FLOOD, 1000),
    "1 bit in 1 % of poses": _some(Kind.CORRUPT, 0.01, "POSE"),
    "1 bit in 1 % of wheel speeds": _some(Kind.CORRUPT, 0.01, "WHEEL_SPEED"),
    "3 bits in 30 % of sensor frames": _some(Kind.CORRUPT, 0.3, *SENSORS, amount=3),
    "3 bits in 30 % of SYNC": _some(Kind.CORRUPT, 0.3, "SYNC", amount=3),
    "3 bits in 30 % of TORQUE": _some(Kind.CORRUPT, 0.3, "TORQUE", amount=3),
    "3 bits in 10 % of all frames": _some(Kind.CORRUPT, 0.1, amount=3),
    "30 % of all frames twice": _some(Kind.REPEAT, 0.3),
    "30 % of all frames after the next": _some(Kind.REORDER, 0.3),
    "30 % of sensor frames after the next": _some(Kind.REORDER, 0.3, *SENSORS),
    "1 % of SYNC 1 tick late": _some(Kind.DELAY, 0.01, "SYNC"),
    "1 % of SYNC 2 ticks late": _some(Kind.DELAY, 0.01, "SYNC", amount=2),
    "30 % of sensor frames 3 ticks late": _some(Kind.DELAY, 0.3, *SENSORS, amount=3),
    "all frames 3 ticks late": _some(Kind.DELAY, 1.0, amount=3),
    "robot paused for 5 ms": _spell(Kind.PAUSE, 5),
    "robot paused for 200 ms": _spell(Kind.PAUSE, 200),
    "robot restarted within 1 ms": _spell(Kind.RESTART, 1),
    "robot restarted after 200 ms": _spell(Kind.RESTART, 200),
}
# The host asks for a stop at the corner.
STOPPED_SCENARIOS: dict[str, tuple[Fault, ...]] = {
    "STOP": (),
    "STOP while 30 % of all frames are lost": _some(Kind.DROP, 0.3),
    "STOP while 3 bits flip in 90 % of commands": _some(Kind.CORRUPT, 0.9, "COMMAND", amount=3),
}


FAULT_ROWS = tuple(
    (name, faults, stop_at, time)
    for time in PACES
    for scenarios, stop_at in ((SCENARIOS, -1), (STOPPED_SCENARIOS, CORNER_TICK))
    for name, faults in scenarios.items()
)


def fault_cases(seed: int = 0) -> Iterator[FaultCase]:
    """Every scenario, by the host's ticks and by the firmware's own timer."""
    return (FaultCase(*row, seed) for row in FAULT_ROWS)


def run_case(case: FaultCase) -> dict[str, Any]:
    """Drive one case; returns its row."""
    request = corner_path(SPEED_M_PER_S)
    with Session(case.time) as session:
        outcome = session.drive(request, FaultPlan(case.faults, case.seed), stop_at=case.stop_at)
        again = session.drives_again(request)
    return {
        "scenario": case.name,
        "time": case.time,
        "end": outcome.end,
        "mode": outcome.mode,
        "dropped": outcome.dropped,
        "missed": outcome.missed,
        "hits": outcome.hits,
        "firmware_ticks": outcome.firmware_ticks,
        "wheels_ticks": outcome.wheels_ticks,
        "distance_m": outcome.distance_m,
        "speed_left_m_per_s": outcome.speed_left_m_per_s,
        "max_torque_Nm": outcome.max_torque_Nm,
        "max_wheel_torque_Nm": outcome.max_wheel_torque_Nm,
        "max_error_m": outcome.max_error_m,
        "violations": len(outcome.violations),
        "drives_again": again,
    }


def run_cases(cases: Iterable[FaultCase], jobs: int | None = None) -> Iterator[dict[str, Any]]:
    """Run cases on so many processes (default: one a core); gives the rows in order."""
    return in_processes(run_case, cases, jobs, at_once=2)


def restart_cases(count: int, seed: int = 0) -> Iterator[FaultCase]:
    """Kill and restart, or pause, the robot at so many random ticks."""
    chance = random.Random(seed)
    for number in range(count):
        kind = chance.choice((Kind.RESTART, Kind.RESTART, Kind.PAUSE))
        fault = Fault(kind, first_tick=chance.randrange(4000), ticks=chance.choice((1, 2, 5, 20, 100)))
        name = f"{kind} at {fault.first_tick} for {fault.ticks}"
        yield FaultCase(name, (fault,), time=chance.choice(PACES), seed=number)


def is_explained(row: dict[str, Any]) -> bool:
    """Tell whether a row breaks no rule: its end has a name, the torque was lawful, the robot drives again."""
    return bool(row["end"] != UNEXPLAINED and row["violations"] == 0 and row["drives_again"])
