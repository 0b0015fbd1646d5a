"""The compiled loop against the one over python-can: the same runs, byte for byte."""

import can
import pytest

from host_sim.codec import Codec
from host_sim.drive import Drive, Status, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.loop import drive_without_bus
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.sweep import BOUNDS_OFF
from host_sim.trace import compare

ROBOT = load_robot()
CORNER = PathRequest("rhombus", 1.0, start_before_corner_s=0.6, duration_s=1.6)


def both(scenario: Scenario, stop_first: bool = False) -> list[Drive]:
    """The drives of a scenario over python-can and without a bus."""
    drives = []
    for way in (drive, drive_without_bus):
        trajectory = plan(scenario.path)
        plant = Plant(ROBOT, scenario.traction_of(ROBOT), scenario.speed_length_m, scenario.delta_m_per_s)
        plant.reset(*start_state(ROBOT, trajectory))
        with InprocBus(node=3) as bus:
            link = Link(bus, Codec(node=3))
            prepare(link, ROBOT, scenario, trajectory)
            if stop_first:
                link.command("STOP")
            drives.append(way(link, plant, ROBOT, trajectory))
    return drives


@pytest.mark.parametrize("order", ["0", "1", "3", "exact", "observer"])
@pytest.mark.parametrize("traction", ["linear", "magic"])
def test_loop_has_the_trace_of_the_bus(order: str, traction: str) -> None:
    over_bus, without = both(Scenario(CORNER, 0.01, order, traction=traction))  # type: ignore[arg-type]

    assert without.status is over_bus.status is Status.COMPLETED
    assert len(without.trace) == 1601
    assert compare(over_bus.trace, without.trace) == []


@pytest.mark.parametrize("epsilon", [1e-11, 5e-5, 0.2])
def test_loop_has_the_trace_of_the_bus_on_every_floor(epsilon: float) -> None:
    over_bus, without = both(Scenario(CORNER, epsilon, output="point"))

    assert compare(over_bus.trace, without.trace) == []


def test_loop_has_the_trace_of_the_bus_from_rest_to_rest() -> None:
    over_bus, without = both(Scenario(PathRequest("circle", 1.5)))

    assert compare(over_bus.trace, without.trace) == []


def test_loop_that_diverges_ends_as_over_the_bus() -> None:
    path = PathRequest("rhombus", 1.5, "sharp", 2.0, 3.0, 1.0)
    over_bus, without = both(Scenario(path, 1.0, "3", traction="linear", parameters=BOUNDS_OFF))

    assert over_bus.status is Status.DIVERGED
    assert (without.status, without.reason) == (over_bus.status, over_bus.reason)
    assert compare(over_bus.trace, without.trace) == []


def test_loop_with_a_firmware_that_does_not_track_ends_as_over_the_bus() -> None:
    over_bus, without = both(Scenario(CORNER), stop_first=True)

    assert over_bus.status is Status.FAULT
    assert "STOPPING" in over_bus.reason
    assert (without.status, without.reason) == (over_bus.status, over_bus.reason)
    assert compare(over_bus.trace, without.trace) == []


def test_loop_over_another_bus_is_refused_by_its_name() -> None:
    with can.Bus(interface="virtual", channel="loop") as bus:
        link = Link(bus, Codec())
        plant = Plant(ROBOT, Scenario(CORNER).traction_of(ROBOT))

        with pytest.raises(OmnibotError, match=r"firmware in-process, not .*loop"):
            drive_without_bus(link, plant, ROBOT, plan(CORNER))
