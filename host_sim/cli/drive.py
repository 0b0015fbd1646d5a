"""Verbs that plan, drive and compare paths."""

import contextlib
import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from host_sim.bus_choice import choose_bus
from host_sim.cli import completion
from host_sim.cli.app import (
    RunFailedError,
    app,
    command_line,
    new_folder,
    parse_numbers,
    parse_settings,
    refuse_uncompleted,
)
from host_sim.cli.bus import (
    BitrateOption,
    BusOption,
    ChannelOption,
    DbcOption,
    InterfaceOption,
    NodeOption,
    TimeoutOption,
    check_timeout,
    link_on,
)
from host_sim.cli.progress import watched
from host_sim.codec import DBC_FILE, Codec
from host_sim.errors import OmnibotError
from host_sim.limits import LIMIT_NAMES, Limits
from host_sim.link import Link, open_bus
from host_sim.parameter_file import read_values
from host_sim.planner import CORNERS, PROFILES, PathRequest, default_speed, plan
from host_sim.preview import Preview
from host_sim.report import PAGE_NAME
from host_sim.report.compare import load_runs, write_comparison
from host_sim.report.plan import write_plan
from host_sim.robot import ROBOT_VARIABLE, load_robot
from host_sim.run import LOG_FILE, BusLog, execute, run_folder
from host_sim.scenario import PACES, SHARED_PARAMETERS, Scenario
from host_sim.sensors import Sensors
from host_sim.trace import compare
from host_sim.trajectory import Trajectory

WITHOUT_CLOCK = {
    "inproc": "the firmware in-process has no timer of its own",
    "pil": "the emulated board counts instructions, not time",
}

EpsilonOption = Annotated[float, typer.Option(help="inverse stiffness of the floor, 1/N, above 0 and at most 1")]
OrderOption = Annotated[
    str,
    typer.Option(
        help="how the firmware predicts slip: order 0, 1, 2 or 3 of the manifold, exact, or observer",
        autocompletion=completion.choice_of("order"),
    ),
]
OutputOption = Annotated[
    str,
    typer.Option(
        help="what follows the path: posture (point and heading) or point",
        autocompletion=completion.choice_of("output"),
    ),
]
TractionOption = Annotated[str, typer.Option(help="linear or magic", autocompletion=completion.choice_of("traction"))]
SettingOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", help="NAME=VALUE of a firmware parameter; may be repeated", autocompletion=completion.setting
    ),
]
PlantOption = Annotated[
    list[str] | None,
    typer.Option(
        help="NAME=NUMBER of the robot that the firmware does not know of, mass_kg=2.3", autocompletion=completion.plant
    ),
]
PathOption = Annotated[
    str,
    typer.Option(
        help="rhombus, line, circle, lemniscate, square, or waypoints: FILE.csv, FILE.toml",
        autocompletion=completion.path,
    ),
]
SpeedOption = Annotated[
    float | None, typer.Option(help="speed along the path, or its limit, m/s (default: 0.5, or the file's)")
]
CornerOption = Annotated[str, typer.Option(help="sharp or rounded", autocompletion=completion.one_of(*CORNERS))]
CornerAccelOption = Annotated[float, typer.Option(help="peak acceleration of corners and ramps, m/s^2")]
DurationOption = Annotated[float | None, typer.Option(help="time to the end, s (default: one lap)")]
StartBeforeCornerOption = Annotated[
    float | None, typer.Option(help="start in motion so many seconds before the first corner")
]
ProfileOption = Annotated[
    str | None,
    typer.Option(
        help="steady speed, or fastest within the limits (default: steady, but for square and waypoints)",
        autocompletion=completion.one_of(*PROFILES),
    ),
]
LimitOption = Annotated[
    list[str] | None,
    typer.Option(help=f"NAME=NUMBER of {', '.join(LIMIT_NAMES)}; may be repeated", autocompletion=completion.limit),
]
RobotOption = Annotated[
    Path | None,
    typer.Option("--robot", envvar=ROBOT_VARIABLE, help="robot file (default: firmware/robot/omnibot.toml)"),
]
CornerCutOption = Annotated[float, typer.Option(help="how far a fastest drive stays off a rounded corner's vertex, m")]


def parse_limits(settings: list[str]) -> Limits:
    """Read NAME=NUMBER pairs."""
    numbers = parse_numbers("--limit", settings)
    for name in numbers:
        if name not in LIMIT_NAMES:
            raise OmnibotError(f"--limit {name}: there is no such limit; there are: {', '.join(LIMIT_NAMES)}")
    return Limits(**numbers)


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
    return f"{result['status']}: {', '.join(figures)}; report: {folder / PAGE_NAME}"


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


def _typed(context: typer.Context) -> set[str]:
    """Return the names of the firmware's parameters that an option of the run was typed for."""
    source = context.get_parameter_source
    return {name for name in SHARED_PARAMETERS if getattr(source(name), "name", "") == "COMMANDLINE"}


def _told(context: typer.Context, file: Path | None) -> dict[str, str]:
    """Return the parameters of a file, but for those that an option was typed for."""
    values = {} if file is None else read_values(file)
    return {name: text for name, text in values.items() if name not in _typed(context)}


def notes(result: dict[str, Any], asked: set[str]) -> list[str]:
    """Return what a user ought to know of the robot's own parameters: a line each, as a rule none."""
    lines = []
    if "PARAMETERS_LOST" in result["cleared_faults"]:
        lines.append(
            "the robot had lost the parameters that it kept, and came up with its defaults (fault PARAMETERS_LOST, now "
            "cleared); omnibot param set and save keep new ones"
        )
    anew = {name: values for name, values in result["overridden_parameters"].items() if name not in asked}
    if anew:
        shown = {name: [_short(values[side]) for side in ("held", "run")] for name, values in anew.items()}
        changes = ", ".join(f"{name} {held} → {ours}" for name, (held, ours) in shown.items())
        options = [f"--{name.replace('_', '-')} {shown[name][0]}" for name in SHARED_PARAMETERS if name in anew]
        options += ["--keep-parameters"] if set(anew) - set(SHARED_PARAMETERS) else []
        lines.append(
            f"the robot held other parameters than this run, and now holds the run's: {changes}; "
            f"to drive with its own: {' '.join(options)}"
        )
    return lines


@app.command()
def run(
    context: typer.Context,
    path: PathOption = "rhombus",
    speed: SpeedOption = None,
    corner: CornerOption = "rounded",
    corner_accel: CornerAccelOption = 2.0,
    epsilon: EpsilonOption = 0.01,
    order: OrderOption = "observer",
    output: OutputOption = "posture",
    traction: TractionOption = "magic",
    duration: DurationOption = None,
    start_before_corner: StartBeforeCornerOption = None,
    profile: ProfileOption = None,
    limit: LimitOption = None,
    corner_cut: CornerCutOption = 0.05,
    robot_file: RobotOption = None,
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    setting: SettingOption = None,
    set_file: Annotated[
        Path | None, typer.Option(help="firmware parameters of a .toml or .json file; options beside it win")
    ] = None,
    keep_parameters: Annotated[
        bool, typer.Option("--keep-parameters", help="leave parameters that no option is for as the robot holds them")
    ] = False,
    plant: PlantOption = None,
    pose_rate_hz: Annotated[
        float | None, typer.Option(help="poses a second; 0: only the first, then dead reckoning (default: every tick)")
    ] = None,
    pose_delay_s: Annotated[float, typer.Option(help="age of a pose when it is sent, s")] = 0.0,
    encoder_counts: Annotated[int, typer.Option(help="encoder counts a turn; 0: no quantisation")] = 0,
    delta_m_per_s: Annotated[float, typer.Option(help="delta of the slip ratio, m/s")] = 1e-3,
    speed_length_m: Annotated[float, typer.Option(help="length that turns yaw rate into speed in (14), m")] = 1.0,
    time: Annotated[
        str,
        typer.Option(
            help="lockstep: neither side waits for the clock; realtime: both keep the control period",
            autocompletion=completion.one_of(*PACES),
        ),
    ] = "lockstep",
    pace: Annotated[float, typer.Option(help="lockstep: never faster than so many times real time")] = math.inf,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print result.json instead of the summary")] = False,
) -> None:
    """Drive one path in closed loop and write trace.npz, result.json, bus.log and report.html."""
    if not pace > 0.0:
        raise OmnibotError(f"--pace {pace:g} must be above 0")
    check_timeout(timeout)
    bus_name = choose_bus(bus, interface, channel, bitrate).label
    if time == "realtime" and bus_name in WITHOUT_CLOCK:
        raise OmnibotError(f"{WITHOUT_CLOCK[bus_name]}: give --time realtime a bus, such as vcan0")
    robot = load_robot(robot_file)
    request = PathRequest(
        path,
        default_speed(path) if speed is None else speed,
        corner,
        corner_accel,
        duration,
        start_before_corner,
        profile,
        parse_limits(limit or []),
        corner_cut,
    )
    settings = parse_settings("--set", setting or [])
    scenario = Scenario(
        path=request,
        epsilon=epsilon,
        order=order,
        output=output,
        traction=traction,  # type: ignore[arg-type]  # checked by Traction
        delta_m_per_s=delta_m_per_s,
        speed_length_m=speed_length_m,
        parameters=_told(context, set_file) | settings,
        keep_parameters=keep_parameters,
        plant=parse_numbers("--plant", plant or []),
        sensors=Sensors(pose_rate_hz, pose_delay_s, encoder_counts),
        time=time,
    )
    scenario.traction_of(scenario.plant_robot(robot))
    scenario.firmware_parameters(robot)
    trajectory = plan(request, robot)
    codec = Codec(dbc, node)
    folder = out or new_folder(Path(path).stem)
    with open_bus(bus, node, interface, channel, bitrate) as opened, run_folder(folder):
        log = BusLog(folder / LOG_FILE, channel="vcan0")
        try:
            link = link_on(opened, codec, timeout, log.record)
            with _progress(link, trajectory, time):
                result = execute(scenario, robot, trajectory, link, log, folder, bus_name, command_line(), pace)
        finally:
            log.close()
    for line in notes(result, _typed(context) | set(settings)):
        print(f"omnibot: {line}", file=sys.stderr)  # noqa: T201
    print(json.dumps(result, indent=2) if as_json else summary(result, folder))  # noqa: T201
    refuse_uncompleted(result, folder)


def _progress(link: Link, trajectory: Trajectory, time: str) -> contextlib.AbstractContextManager[None]:
    """Show how far a drive is; not by the clock, where the drawing would make ticks late."""
    if time == "realtime":
        return contextlib.nullcontext()
    return watched("drive", trajectory.duration_us * 1e-6, lambda: link.time_s)


@app.command("plan")
def preview(
    path: PathOption = "rhombus",
    speed: SpeedOption = None,
    corner: CornerOption = "rounded",
    corner_accel: CornerAccelOption = 2.0,
    duration: DurationOption = None,
    start_before_corner: StartBeforeCornerOption = None,
    profile: ProfileOption = None,
    limit: LimitOption = None,
    corner_cut: CornerCutOption = 0.05,
    robot_file: RobotOption = None,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print plan.json instead of the table")] = False,
) -> None:
    """Plan a path without driving it: length, duration, and what it asks of the robot beside the limits."""
    request = PathRequest(
        path,
        default_speed(path) if speed is None else speed,
        corner,
        corner_accel,
        duration,
        start_before_corner,
        profile,
        parse_limits(limit or []),
        corner_cut,
    )
    made = Preview(request, load_robot(robot_file))
    written = write_plan(out or new_folder(f"plan-{Path(path).stem}"), made, command_line())
    print(json.dumps(made.numbers(), indent=2) if as_json else f"{made.text()}\n\nreport: {written}")  # noqa: T201


@app.command("compare")
def compare_runs(
    folders: Annotated[list[Path], typer.Argument(metavar="RUN RUN …", help="folders of two or more runs")],
    out: Annotated[Path | None, typer.Option(help="folder of the page (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the differences as JSON")] = False,
) -> None:
    """Put runs side by side on a page, and say whether their traces are the same, byte for byte, and where not.

    As with diff, the exit code is 0 if all of them are the same, 1 if one differs from the first.
    """
    if len(folders) < 2:
        raise OmnibotError(f"compare {folders[0]}: needs a second run to hold it against")
    first, *others = runs = load_runs(folders)
    differences = {run.name: compare(first.trace, run.trace) for run in others}
    folder = out or new_folder("compare")
    page = write_comparison(folder, runs, differences, load_robot(), command_line())
    different = [(name, lines) for name, lines in differences.items() if lines]
    if as_json:
        print(json.dumps({"identical": not different, "differences": differences, "report": str(page)}, indent=2))  # noqa: T201
    else:
        print(f"report: {page}")  # noqa: T201
        for name, lines in different:
            for line in lines:
                print(line if len(others) == 1 else f"{name}: {line}")  # noqa: T201
    if different:
        what = "; ".join(f"{first.name} and {name} differ in {len(lines)} arrays" for name, lines in different)
        raise RunFailedError(what)
    if not as_json:
        same = " and ".join(map(str, folders))
        print(f"identical: {same} agree in every array, all {len(first.trace)} ticks, byte for byte")  # noqa: T201
