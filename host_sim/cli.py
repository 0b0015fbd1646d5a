"""The command line: ``omnibot VERB``."""

import itertools
import json
import math
import shlex
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.text import Text

from host_sim.bench import bench
from host_sim.bench import choose as choose_parts
from host_sim.bench import table as bench_table
from host_sim.busload import bus_load, load_table
from host_sim.codec import DBC_FILE, Codec, load_messages
from host_sim.errors import OmnibotError
from host_sim.flash import IMAGE_FILE, flash
from host_sim.inject import FAULT_ROWS, fault_cases, is_explained, restart_cases, run_cases
from host_sim.limits import LIMIT_NAMES, Limits
from host_sim.link import Link, open_bus
from host_sim.paper import choose, write_paper
from host_sim.pil import EmulatedBoard
from host_sim.planner import PathRequest, default_speed, plan
from host_sim.preview import Preview
from host_sim.report import PAGE_NAME
from host_sim.report.compare import load_runs, write_comparison
from host_sim.report.plan import write_plan
from host_sim.robot import ROOT, load_robot
from host_sim.run import LOG_FILE, BusLog, execute, run_folder
from host_sim.scenario import Scenario
from host_sim.sensors import Sensors
from host_sim.soak import soak
from host_sim.sweep import SWEEPS, run_sweep, table
from host_sim.trace import compare, write_atomically

WITHOUT_CLOCK = {
    "inproc": "the firmware in-process has no timer of its own",
    "pil": "the emulated board counts instructions, not time",
}


class RunFailedError(OmnibotError):
    """A run that did not complete; its result was printed already."""


COST_TOOL = ROOT / "tools" / "step_cost"

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


@app.callback()
def omnibot() -> None:
    """Drive a simulated robot with slipping wheels by the firmware that goes to the board."""


def parse_settings(option: str, settings: list[str]) -> dict[str, str]:
    """Read NAME=VALUE pairs."""
    values = {}
    for setting in settings:
        name, separator, text = setting.partition("=")
        if not name or not separator or not text:
            raise OmnibotError(f"{option} {setting}: must be NAME=VALUE")
        values[name] = text
    return values


def parse_numbers(option: str, settings: list[str]) -> dict[str, float]:
    """Read NAME=NUMBER pairs."""
    try:
        return {name: float(text) for name, text in parse_settings(option, settings).items()}
    except ValueError as error:
        raise OmnibotError(f"{option}: {error}; must be NAME=NUMBER") from None


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


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


def parse_limits(settings: list[str]) -> Limits:
    """Read NAME=NUMBER pairs."""
    numbers = parse_numbers("--limit", settings)
    for name in numbers:
        if name not in LIMIT_NAMES:
            raise OmnibotError(f"--limit {name}: there is no such limit; there are: {', '.join(LIMIT_NAMES)}")
    return Limits(**numbers)


PathOption = Annotated[
    str, typer.Option(help="rhombus, line, circle, lemniscate, square, or waypoints: FILE.csv, FILE.toml")
]
SpeedOption = Annotated[
    float | None, typer.Option(help="speed along the path, or its limit, m/s (default: 0.5, or the file's)")
]
CornerOption = Annotated[str, typer.Option(help="sharp or rounded")]
CornerAccelOption = Annotated[float, typer.Option(help="peak acceleration of corners and ramps, m/s^2")]
DurationOption = Annotated[float | None, typer.Option(help="time to the end, s (default: one lap)")]
StartBeforeCornerOption = Annotated[
    float | None, typer.Option(help="start in motion so many seconds before the first corner")
]
ProfileOption = Annotated[
    str | None,
    typer.Option(help="steady speed, or fastest within the limits (default: steady, but for square and waypoints)"),
]
LimitOption = Annotated[
    list[str] | None, typer.Option(help=f"NAME=NUMBER of {', '.join(LIMIT_NAMES)}; may be repeated")
]
CornerCutOption = Annotated[float, typer.Option(help="how far a fastest drive stays off a rounded corner's vertex, m")]


@app.command()
def run(
    path: PathOption = "rhombus",
    speed: SpeedOption = None,
    corner: CornerOption = "rounded",
    corner_accel: CornerAccelOption = 2.0,
    epsilon: Annotated[float, typer.Option(help="inverse stiffness of the floor, 1/N, above 0 and at most 1")] = 0.01,
    order: Annotated[
        str, typer.Option(help="how the firmware predicts slip: order 0, 1, 2 or 3 of the manifold, exact, or observer")
    ] = "observer",
    output: Annotated[
        str, typer.Option(help="what follows the path: posture (point and heading) or point")
    ] = "posture",
    traction: Annotated[str, typer.Option(help="linear or magic")] = "magic",
    duration: DurationOption = None,
    start_before_corner: StartBeforeCornerOption = None,
    profile: ProfileOption = None,
    limit: LimitOption = None,
    corner_cut: CornerCutOption = 0.05,
    bus: Annotated[
        str, typer.Option(help="inproc, pil (the board's image, emulated), or a SocketCAN interface")
    ] = "inproc",
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface, over --bus")] = None,
    channel: Annotated[
        str | None,
        typer.Option("-c", "--channel", help="python-can channel; with --bus pil the image, if not build/board's"),
    ] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="bit/s, where the interface wants it")] = None,
    node: Annotated[int, typer.Option(help="the robot's node on the bus, 0 to 15")] = 0,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE of a firmware parameter; may be repeated")
    ] = None,
    plant: Annotated[
        list[str] | None, typer.Option(help="NAME=NUMBER of the robot that the firmware does not know of, mass_kg=2.3")
    ] = None,
    pose_rate_hz: Annotated[
        float | None, typer.Option(help="poses a second; 0: only the first, then dead reckoning (default: every tick)")
    ] = None,
    pose_delay_s: Annotated[float, typer.Option(help="age of a pose when it is sent, s")] = 0.0,
    encoder_counts: Annotated[int, typer.Option(help="encoder counts a turn; 0: no quantisation")] = 0,
    delta_m_per_s: Annotated[float, typer.Option(help="delta of the slip ratio, m/s")] = 1e-3,
    speed_length_m: Annotated[float, typer.Option(help="length that turns yaw rate into speed in (14), m")] = 1.0,
    time: Annotated[
        str, typer.Option(help="lockstep: neither side waits for the clock; realtime: both keep the control period")
    ] = "lockstep",
    pace: Annotated[float, typer.Option(help="lockstep: never faster than so many times real time")] = math.inf,
    timeout: Annotated[float, typer.Option(help="wall-clock seconds the firmware may be silent")] = 2.0,
    dbc: Annotated[Path, typer.Option(help="wire definition to speak")] = DBC_FILE,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print result.json instead of the summary")] = False,
) -> None:
    """Drive one path in closed loop and write trace.npz, result.json, bus.log and report.html."""
    if not pace > 0.0:
        raise OmnibotError(f"--pace {pace:g} must be above 0")
    if not 1e-3 <= timeout <= 3600.0:
        raise OmnibotError(f"--timeout {timeout:g} must be 0.001 … 3600 s")
    if time == "realtime" and interface is None and bus in WITHOUT_CLOCK:
        raise OmnibotError(f"{WITHOUT_CLOCK[bus]}: give --time realtime a bus, such as vcan0")
    robot = load_robot()
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
    scenario = Scenario(
        path=request,
        epsilon=epsilon,
        order=order,
        output=output,
        traction=traction,  # type: ignore[arg-type]  # checked by Traction
        delta_m_per_s=delta_m_per_s,
        speed_length_m=speed_length_m,
        parameters=parse_settings("--set", setting or []),
        plant=parse_numbers("--plant", plant or []),
        sensors=Sensors(pose_rate_hz, pose_delay_s, encoder_counts),
        time=time,
    )
    scenario.traction_of(scenario.plant_robot(robot))
    scenario.firmware_parameters(robot)
    trajectory = plan(request)
    codec = Codec(dbc, node)
    folder = out or _new_folder(Path(path).stem)
    bus_name = bus if interface is None else f"{interface}:{channel}"
    with open_bus(bus, node, interface, channel, bitrate) as opened, run_folder(folder):
        log = BusLog(folder / LOG_FILE, channel="vcan0")
        try:
            # An emulator loses nothing: asking again where a machine is slow would only fill the log.
            repeat_s = timeout if isinstance(opened, EmulatedBoard) else None
            link = Link(opened, codec, timeout, log.record, repeat_s)
            result = execute(scenario, robot, trajectory, link, log, folder, bus_name, _command_line(), pace)
        finally:
            log.close()
    print(json.dumps(result, indent=2) if as_json else summary(result, folder))  # noqa: T201
    if result["status"] != "completed":
        raise RunFailedError(result["reason"])


def _new_folder(name: str) -> Path:
    """Return a folder below runs/ that no other run has."""
    stem = f"{datetime.now().astimezone():%Y-%m-%d-%H%M%S}-{name}"
    candidates = (ROOT / "runs" / (stem if number == 0 else f"{stem}-{number}") for number in itertools.count())
    return next(folder for folder in candidates if not folder.exists())


def _command_line() -> str:
    """Return the command that was typed."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


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
    made = Preview(request, load_robot())
    written = write_plan(out or _new_folder(f"plan-{Path(path).stem}"), made, _command_line())
    print(json.dumps(made.numbers(), indent=2) if as_json else f"{made.text()}\n\nreport: {written}")  # noqa: T201


@app.command("compare")
def compare_runs(
    folders: Annotated[list[Path], typer.Argument(metavar="RUN RUN …", help="folders of two or more runs")],
    out: Annotated[Path | None, typer.Option(help="folder of the page (default: a new one below runs/)")] = None,
) -> None:
    """Put runs side by side on a page, and say whether their traces are the same, byte for byte, and where not.

    As with diff, the exit code is 0 if all of them are the same, 1 if one differs from the first.
    """
    if len(folders) < 2:
        raise OmnibotError(f"compare {folders[0]}: needs a second run to hold it against")
    first, *others = runs = load_runs(folders)
    differences = {run.name: compare(first.trace, run.trace) for run in others}
    folder = out or _new_folder("compare")
    page = write_comparison(folder, runs, differences, load_robot(), _command_line())
    print(f"report: {page}")  # noqa: T201
    different = [(name, lines) for name, lines in differences.items() if lines]
    for name, lines in different:
        for line in lines:
            print(line if len(others) == 1 else f"{name}: {line}")  # noqa: T201
    if different:
        what = "; ".join(f"{first.name} and {name} differ in {len(lines)} arrays" for name, lines in different)
        raise OmnibotError(what)
    same = " and ".join(map(str, folders))
    print(f"identical: {same} agree in every array, all {len(first.trace)} ticks, byte for byte")  # noqa: T201


@app.command()
def paper(
    only: Annotated[
        str | None, typer.Option(help="comma-separated: fig2, fig3a, fig3b, fig4, fig5, table1 (default: all)")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print paper.json instead of the page's place")] = False,
) -> None:
    """Draw every figure and table of the paper beside ours, and write them as report.html and paper.json."""
    names, robot = choose(only), load_robot()
    folder = out or ROOT / "runs" / f"{datetime.now().astimezone():%Y-%m-%d-%H%M%S}-paper"
    numbers = write_paper(names, robot, folder, _command_line(), lambda line: typer.echo(line, err=True))
    print(json.dumps(numbers, indent=2) if as_json else f"page: {folder / PAGE_NAME}")  # noqa: T201


@app.command()
def sweep(
    name: Annotated[str, typer.Argument(help="stability, robustness or odometry")],
    out: Annotated[Path | None, typer.Option(help="folder for the table (default: runs/sweep-NAME)")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="processes (default: one a core)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the rows as JSON instead of the table")] = False,
) -> None:
    """Run a table of scenarios in-process: stability 1,920 runs, robustness 66, odometry 12."""
    if name not in SWEEPS:
        raise OmnibotError(f"no sweep {name!r}; there are: {', '.join(SWEEPS)}")
    folder = out or ROOT / "runs" / f"sweep-{name}"
    total = sum(1 for _ in SWEEPS[name]())
    rows = list(track(run_sweep(name, jobs), total=total, console=Console(stderr=True), description=name))
    write_atomically(folder / "sweep.json", (json.dumps(rows, indent=2) + "\n").encode())
    write_atomically(folder / "sweep.md", table(rows).encode())
    print(json.dumps(rows, indent=2) if as_json else table(rows))  # noqa: T201
    lost = sum(row["status"] != "completed" for row in rows)
    print(f"{len(rows)} runs, {lost} not completed; table: {folder / 'sweep.md'}", file=sys.stderr)  # noqa: T201


@app.command()
def inject(
    seed: Annotated[int, typer.Option(help="of the chance in the faults")] = 0,
    restarts: Annotated[
        int, typer.Option(min=0, help="instead of the table: restart or pause the robot at so many random ticks")
    ] = 0,
    out: Annotated[Path | None, typer.Option(help="folder for the table (default: runs/inject)")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="processes (default: one a core)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the rows as JSON instead of the table")] = False,
) -> None:
    """Drive in-process over a bus that loses, delays, repeats, swaps, damages and floods; table what the robot does."""
    folder = out or ROOT / "runs" / "inject"
    cases, total = (restart_cases(restarts, seed), restarts) if restarts else (fault_cases(seed), len(FAULT_ROWS))
    rows = list(track(run_cases(cases, jobs), total=total, console=Console(stderr=True), description="inject"))
    write_atomically(folder / "inject.json", (json.dumps(rows, indent=2) + "\n").encode())
    write_atomically(folder / "inject.md", table(rows).encode())
    print(json.dumps(rows, indent=2) if as_json else table(rows))  # noqa: T201
    wrong = [row for row in rows if not is_explained(row)]
    print(f"{len(rows)} drives, {len(wrong)} against a rule; table: {folder / 'inject.md'}", file=sys.stderr)  # noqa: T201
    if wrong:
        raise OmnibotError(
            f"{wrong[0]['scenario']} ({wrong[0]['time']}): {wrong[0]['end']}, or torque or restart wrong"
        )


@app.command("soak")
def soak_command(
    duration: Annotated[float, typer.Option(min=1.0, help="simulated time to drive, s")] = 3600.0,
    wall: Annotated[float, typer.Option(min=1.0, help="stop after so much time by the clock, s")] = math.inf,
    seed: Annotated[int, typer.Option(help="of everything that happens by chance")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="print the result as JSON")] = False,
) -> None:
    """Drive for long in-process with random faults; every end must have a reason, and memory must stay."""
    result = soak(duration, wall, seed)
    ends = "".join(f"\n  {count:6d}  {end}" for end, count in result.ends.most_common())
    text = (
        f"{result.simulated_s:.0f} s simulated in {result.wall_s:.0f} s: {result.drives} drives, {result.frames_hit} "
        f"frames hit, largest torque {result.max_torque_Nm:.3g} N*m; after warming up the resident set "
        f"({result.peak_KiB_after_warm_up} KiB) grew by {result.peak_growth_KiB} KiB, Python's blocks by "
        f"{result.block_growth}{ends}"
    )
    print(json.dumps(result.as_dict(), indent=2) if as_json else text)  # noqa: T201
    if result.problems:
        raise OmnibotError(f"{len(result.problems)} drives against a rule; the first: {result.problems[0]}")


@app.command(add_help_option=False, context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def cost(context: typer.Context) -> None:
    """Tell what a step costs on the target: instructions, cycles, stack, flash and RAM (omnibot cost --help)."""
    # The meter knows the firmware's symbols, this package does not: it is a tool of the source tree.
    raise typer.Exit(subprocess.run([sys.executable, COST_TOOL, *context.args], check=False).returncode)


@app.command("flash")
def flash_board(
    runner: Annotated[
        str | None, typer.Option(help="openocd, st-flash, pyocd or dfu-util (default: the first that is installed)")
    ] = None,
    image: Annotated[Path, typer.Option(help="what the flash shall hold")] = IMAGE_FILE,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only show the commands")] = False,
) -> None:
    """Write the firmware into a board's flash, verify it, and reset the board."""
    flash(runner, image, dry_run, typer.echo)
    if not dry_run:
        print(f"flashed and verified: {image}")  # noqa: T201


@app.command("bench")
def run_bench(
    only: Annotated[str | None, typer.Option(help="comma-separated: plant, loop, vcan (default: all)")] = None,
    bus: Annotated[str, typer.Option(help="SocketCAN interface of the vcan part")] = "vcan0",
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of the table")] = False,
) -> None:
    """Measure the speed of plant, loop and bus, each beside its reference, as ratios of one run."""
    result = bench(choose_parts(only), bus)
    print(json.dumps(result, indent=2) if as_json else bench_table(result))  # noqa: T201


@app.command()
def busload(
    nodes: Annotated[int, typer.Option(help="robots on one bus, 1 to 16")] = 1,
    bitrate: Annotated[int, typer.Option("-b", "--bitrate", help="bit/s")] = 1_000_000,
    dbc: Annotated[Path, typer.Option(help="wire definition")] = DBC_FILE,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of the table")] = False,
) -> None:
    """Compute load and worst-case response times of the bus from the wire definition; fails where they do not hold."""
    load = bus_load(load_messages(dbc), nodes, bitrate)
    print(json.dumps(load.as_dict(), indent=2) if as_json else load_table(load))  # noqa: T201
    if load.failures:
        raise RunFailedError("; ".join(load.failures))


def main() -> None:
    """Run the command line; an error that the user can cure is one line and exit code 1."""
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # a terminal without our letters
    try:
        app()
    except (OmnibotError, OSError) as error:
        # Text, not markup: what the user typed may hold brackets.
        Console(stderr=True).print(Text.assemble(("omnibot:", "bold red"), f" {error}"), soft_wrap=True)
        if "--json" in sys.argv and not isinstance(error, RunFailedError):
            print(json.dumps({"status": "error", "reason": str(error)}))  # noqa: T201
        sys.exit(1)
