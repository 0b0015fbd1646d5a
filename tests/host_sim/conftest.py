"""What several test modules look at."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

from host_sim.codec import Codec
from host_sim.drive import Status, drive, start_state
from host_sim.link import Link, open_bus
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.run import LOG_FILE, BusLog, prepare
from host_sim.scenario import Scenario


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Return a Chromium, for pages as a person sees them."""
    executable = shutil.which("chromium") or shutil.which("google-chrome")
    assert executable, "no Chromium: tools/setup test installs one"
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a drive of 0.76 s in-process, with bus.log and trace.npz; not to be changed."""
    folder, robot = tmp_path_factory.mktemp("recorded"), load_robot()
    scenario = Scenario(PathRequest("lemniscate", 0.4, duration_s=0.76))
    trajectory, log = plan(scenario.path), BusLog(folder / LOG_FILE, channel="vcan0")
    plant = Plant(robot, scenario.traction_of(robot))
    plant.reset(*start_state(robot, trajectory))
    with open_bus("inproc", 0, None, None, None) as bus:
        link = Link(bus, Codec(), record=log.record)
        prepare(link, robot, scenario, trajectory)
        driven = drive(link, plant, robot, trajectory)
        link.command("STOP")
    log.close()
    assert driven.status is Status.COMPLETED
    driven.trace.save(folder)
    return folder
