"""The command line: ``omnibot VERB``."""

import json
import math
import shlex
import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from host_sim.codec import DBC_FILE, Codec
from host_sim.errors import OmnibotError
from host_sim.link import Link, open_bus
from host_sim.planner import PathRequest, plan
from host_sim.robot import ROOT, load_robot
from host_sim.run import BusLog, Scenario, execute, run_folder
from host_sim.trace import Trace, compare

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


@app.callback()
def omnibot() -> None:
    """Drive a simulated robot with slipping wheels by the firmware that goes to the board."""


def parse_settings(settings: list[str]) -> dict[str, float]:
    """Read NAME=VALUE pairs."""
    values = {}
    for setting in settings:
        name, separator, text = setting.partition("=")
        try:
            values[name] = float(text)
        except ValueError:
            separator = ""
        if not separator:
            raise OmnibotError(f"--set {setting}: must be NAME=NUMBER, such as position_damping_per_s=30")
    return values


def summary(result: dict[str, Any], folder: Path) -> str:
    """Return the result in one line a person can read."""
    tracking, slip, torque, timing = (result[part] for part in ("tracking", "slip", "torque", "timing"))
    figures = [
        f"max error {_figure(tracking['max_error_m'], 1e3)} mm",
        f"path deviation {_figure(tracking['max_path_deviation_m'], 1e3)} mm",
        f"max slip ratio {_figure(slip['max_ratio'])}",
        f"max torque {_figure(torque['max_Nm'])} N*m",
        f"{_figure(timing['real_time_factor'])} times real time",
    ]
    return f"{result['status']}: {', '.join(figures)}; report: {folder / 'report.html'}"


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


@app.command()
def run(
    path: Annotated[str, typer.Option(help="rhombus, line, circle or lemniscate")] = "rhombus",
    speed: Annotated[float, typer.Option(help="speed along the path, m/s")] = 0.5,
    corner: Annotated[str, typer.Option(help="sharp or rounded")] = "rounded",
    corner_accel: Annotated[float, typer.Option(help="peak acceleration of corners and ramps, m/s^2")] = 2.0,
    epsilon: Annotated[float, typer.Option(help="inverse stiffness of the floor, 1/N, above 0 and at most 1")] = 0.01,
    order: Annotated[int, typer.Option(help="order of the manifold in the firmware: 0 or 1")] = 1,
    traction: Annotated[str, typer.Option(help="linear or magic")] = "magic",
    duration: Annotated[float | None, typer.Option(help="time to the end, s (default: one lap)")] = None,
    start_before_corner: Annotated[
        float | None, typer.Option(help="start in motion so many seconds before the first corner")
    ] = None,
    bus: Annotated[str, typer.Option(help="inproc, or a SocketCAN interface such as vcan0")] = "inproc",
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface, over --bus")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="python-can channel")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="bit/s, where the interface wants it")] = None,
    node: Annotated[int, typer.Option(help="the robot's node on the bus, 0 to 15")] = 0,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE of a firmware parameter; may be repeated")
    ] = None,
    delta_m_per_s: Annotated[float, typer.Option(help="delta of the slip ratio, m/s")] = 1e-3,
    speed_length_m: Annotated[float, typer.Option(help="length that turns yaw rate into speed in (14), m")] = 1.0,
    pace: Annotated[float, typer.Option(help="never faster than so many times real time")] = math.inf,
    timeout: Annotated[float, typer.Option(help="wall-clock seconds the firmware may be silent")] = 2.0,
    dbc: Annotated[Path, typer.Option(help="wire definition to speak")] = DBC_FILE,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print result.json instead of the summary")] = False,
) -> None:
    """Drive one path in closed loop and write trace.npz, result.json, bus.log, figures and report.html."""
    if not pace > 0.0 or not timeout > 0.0:
        raise OmnibotError(f"--pace {pace:g} and --timeout {timeout:g} must be above 0")
    robot = load_robot()
    request = PathRequest(path, speed, corner, corner_accel, duration, start_before_corner)
    scenario = Scenario(
        request,
        epsilon,
        order,
        traction,  # type: ignore[arg-type]  # checked by Traction
        delta_m_per_s,
        speed_length_m,
        parse_settings(setting or []),
    )
    scenario.traction_of(robot)
    for name, value in scenario.firmware_parameters().items():
        robot.parameter(name).check(value)
    trajectory = plan(request)
    codec = Codec(dbc, node)
    folder = out or ROOT / "runs" / f"{datetime.now().astimezone():%Y-%m-%d-%H%M%S}-{path}"
    bus_name = bus if interface is None else f"{interface}:{channel}"
    with run_folder(folder), open_bus(bus, node, interface, channel, bitrate) as opened:
        log = BusLog(folder / "bus.log", channel="vcan0")
        try:
            link = Link(opened, codec, timeout, log.record)
            result = execute(scenario, robot, trajectory, link, folder, bus_name, _command_line(), pace)
        finally:
            log.close()
    print(json.dumps(result, indent=2) if as_json else summary(result, folder))  # noqa: T201
    if result["status"] != "completed":
        raise OmnibotError(result["reason"])


def _command_line() -> str:
    """Return the command that was typed."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


@app.command("compare")
def compare_runs(
    first: Annotated[Path, typer.Argument(help="folder of a run")],
    second: Annotated[Path, typer.Argument(help="folder of another")],
) -> None:
    """Say whether the traces of two runs are the same, byte for byte, and where not."""
    a, b = Trace.load(first), Trace.load(second)
    differences = compare(a, b)
    for line in differences:
        print(line)  # noqa: T201
    if differences:
        raise OmnibotError(f"{first} and {second} differ in {len(differences)} arrays")
    print(f"identical: {first} and {second} agree in every array, all {len(a)} ticks, byte for byte")  # noqa: T201


def main() -> None:
    """Run the command line; an error that the user can cure is one line and exit code 1."""
    try:
        app()
    except OmnibotError as error:
        Console(stderr=True).print(f"[bold red]omnibot:[/] {error}", soft_wrap=True, highlight=False)
        sys.exit(1)
