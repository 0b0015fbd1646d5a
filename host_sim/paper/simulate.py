"""Closed-loop runs on the in-process bus that leave no folder behind."""

from dataclasses import dataclass

import can

from host_sim.codec import Codec
from host_sim.drive import Status, drive, start_state
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.metrics import Metrics, measure
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import Robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.trace import Trace
from host_sim.traction import Traction, TractionKind
from host_sim.trajectory import Trajectory


@dataclass(frozen=True)
class Case:
    """A run around the first corner of the rhombus; ε = 0 is the rigid plant, and a firmware that believes in it."""

    speed_m_per_s: float
    epsilon: float
    order: str = "1"
    corner: str = "rounded"
    traction: TractionKind = "magic"
    start_before_corner_s: float = 2.0
    duration_s: float = 4.0
    parameters: tuple[tuple[str, str], ...] = ()

    @property
    def scenario(self) -> Scenario:
        """All inputs of the run."""
        path = PathRequest(
            "rhombus",
            self.speed_m_per_s,
            self.corner,
            duration_s=self.duration_s,
            start_before_corner_s=self.start_before_corner_s,
        )
        return Scenario(path, self.epsilon, self.order, traction=self.traction, parameters=dict(self.parameters))


@dataclass(frozen=True)
class Outcome:
    """What came out of a run."""

    status: Status
    trace: Trace
    metrics: Metrics
    delta_m_per_s: float

    @property
    def path_deviation_m(self) -> float:
        """Largest distance from the path; infinite if a number was lost on the way."""
        deviation = self.metrics.tracking.max_path_deviation_m
        return float("inf") if deviation is None else deviation

    @property
    def error_m(self) -> float:
        """Largest tracking error; infinite if a number was lost on the way."""
        error = self.metrics.tracking.max_error_m
        return float("inf") if error is None else error


class RecordingBus(InprocBus):
    """An in-process bus that keeps the frames sent to the firmware."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, bytes]] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Give the firmware a frame, and keep a copy."""
        self.sent.append((msg.arbitration_id, bytes(msg.data)))
        super().send(msg, timeout)


class Simulator:
    """Runs cases on one robot, each only once."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._outcomes: dict[Case, Outcome] = {}

    def run(self, case: Case) -> Outcome:
        """Run a case, or return what it gave before."""
        if case not in self._outcomes:
            with InprocBus() as bus:
                self._outcomes[case] = self._run(case, bus)
        return self._outcomes[case]

    def run_recorded(self, case: Case) -> tuple[Outcome, list[tuple[int, bytes]]]:
        """Run a case; returns the frames sent to the firmware too: identifier and payload."""
        with RecordingBus() as bus:
            outcome = self._run(case, bus)
            return outcome, bus.sent

    def plant(self, case: Case, trajectory: Trajectory) -> Plant:
        """Return the plant of a case, on the reference."""
        scenario = case.scenario
        traction = Traction.of(self.robot, case.traction, case.epsilon)
        plant = Plant(self.robot, traction, scenario.speed_length_m, scenario.delta_m_per_s)
        plant.reset(*start_state(self.robot, trajectory))
        return plant

    def _run(self, case: Case, bus: can.BusABC) -> Outcome:
        scenario = case.scenario
        trajectory = plan(scenario.path)
        plant = self.plant(case, trajectory)
        link = Link(bus, Codec())
        prepare(link, self.robot, scenario, trajectory)
        driven = drive(link, plant, self.robot, trajectory)
        if driven.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        metrics = measure(driven.trace, trajectory.path.distance, self.robot.torque_limit_Nm)
        return Outcome(driven.status, driven.trace, metrics, scenario.delta_m_per_s)
