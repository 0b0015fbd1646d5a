"""The closed loop over a SocketCAN interface, beside two processes in C that pass the same frames and no more."""

import json
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from host_sim.bench.loops import drive_once, real_time_factor
from host_sim.codec import Codec
from host_sim.drive import drive
from host_sim.errors import OmnibotError
from host_sim.link import Link, is_can_interface, open_bus
from host_sim.planner import PathRequest, plan
from host_sim.robot import ROOT, load_robot
from host_sim.scenario import Scenario

FIRMWARE, PINGPONG = (ROOT / "build" / "host" / name for name in ("omnibot-sil", "omnibot-pingpong"))
WITH_VCAN, OWN_INTERFACE = ROOT / "tools" / "with-vcan", "vcan0"
OURSELVES = (sys.executable, "-c", "from host_sim.cli import main; main()", "bench", "--only", "vcan", "--json")
NODE, PINGPONG_NODE = 14, 15
FIGURES = ("vcan_kernel", "vcan_us_per_tick", "pingpong_us_per_tick", "vcan_vs_pingpong")
ROUNDS = 5  # by turns; the fastest of each counts


@contextmanager
def _firmware(interface: str) -> Iterator[None]:
    """Run the firmware as a process."""
    try:
        process = subprocess.Popen([FIRMWARE, "--can", interface, "--node", str(NODE)], stderr=subprocess.DEVNULL)
    except OSError as error:
        raise OmnibotError(f"no firmware for this machine ({error}); tools/build host makes it") from error
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def _pingpong_s(interface: str, ticks: int) -> float:
    """Return the seconds of a tick of frames alone."""
    done = subprocess.run(
        [PINGPONG, interface, str(PINGPONG_NODE), str(ticks)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise OmnibotError(f"{done.stderr.strip() or PINGPONG.name}; tools/build host makes it")
    return 1e-9 * int(done.stdout)


def measure_vcan(interface: str) -> dict[str, Any]:
    """Measure both on an interface; where there is no vcan0, on that of tools/with-vcan. Else say how to get one."""
    if is_can_interface(interface):
        return _measure(interface)
    missing = f"no CAN interface {interface} here, so nothing was measured over it"
    if interface != OWN_INTERFACE:
        return {"missing": f"{missing}; with --bus {OWN_INTERFACE} tools/with-vcan makes one"}
    done = subprocess.run([WITH_VCAN, "--", *OURSELVES], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        return {"missing": f"{missing}; tools/with-vcan failed: {''.join(reason)}"}
    figures: dict[str, Any] = json.loads(done.stdout[done.stdout.index("{") :])
    return {name: value for name, value in figures.items() if name in FIGURES}


def _measure(interface: str) -> dict[str, Any]:
    robot = load_robot()
    scenario = Scenario(PathRequest("rhombus", 1.0, start_before_corner_s=0.6, duration_s=1.6))
    trajectory = plan(scenario.path)
    lockstep_s, pingpong_s = [], []
    for _ in range(ROUNDS):
        with _firmware(interface), open_bus(interface, NODE, None, None, None) as bus:
            driven = drive_once(drive, Link(bus, Codec(node=NODE)), scenario, robot, trajectory)
        lockstep_s.append(robot.control_period_s / real_time_factor(driven, robot))
        pingpong_s.append(_pingpong_s(interface, len(driven.trace)))
    kernel = f"Linux {platform.release()}"
    values = kernel, 1e6 * min(lockstep_s), 1e6 * min(pingpong_s), min(lockstep_s) / min(pingpong_s)
    return dict(zip(FIGURES, values, strict=True))
