"""Verbs that study the law, the bus and the simulator: many runs, or none."""

import contextlib
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from host_sim.bench import PARTS, bench
from host_sim.bench import choose as choose_parts
from host_sim.bench import table as bench_table
from host_sim.busload import bus_load, load_table
from host_sim.cli import completion
from host_sim.cli.app import RUNS, CutShortError, RunFailedError, app, command_line, new_folder
from host_sim.cli.progress import refuse_cut_short, until_ctrl_c, watched
from host_sim.codec import DBC_FILE, load_messages
from host_sim.errors import OmnibotError
from host_sim.inject import FAULT_ROWS, fault_cases, is_explained, restart_cases, run_cases
from host_sim.paper import choose, write_paper
from host_sim.paper.write import ITEMS
from host_sim.report import PAGE_NAME
from host_sim.robot import ROOT, load_robot
from host_sim.soak import SoakResult, soak
from host_sim.sweep import SWEEPS, run_sweep, table
from host_sim.trace import write_atomically

COST_TOOL = ROOT / "tools" / "step_cost"


@app.command()
def paper(
    only: Annotated[
        str | None,
        typer.Option(
            help="comma-separated: fig2, fig3a, fig3b, fig4, fig5, table1 (default: all)",
            autocompletion=completion.some_of(*ITEMS),
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print paper.json instead of the page's place")] = False,
) -> None:
    """Draw every figure and table of the paper beside ours, and write them as report.html and paper.json."""
    names, robot = choose(only), load_robot()
    folder = out or new_folder("paper")
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        typer.echo(line, err=True)

    with watched("paper", len(names), lambda: len(said)):
        numbers = write_paper(names, robot, folder, command_line(), say)
    print(json.dumps(numbers, indent=2) if as_json else f"page: {folder / PAGE_NAME}")  # noqa: T201
    if "missing" in numbers:
        raise CutShortError(f"interrupted: {folder / PAGE_NAME} is without {', '.join(numbers['missing'])}")


@app.command()
def sweep(
    name: Annotated[
        str, typer.Argument(help="stability, robustness or odometry", autocompletion=completion.one_of(*SWEEPS))
    ],
    out: Annotated[Path | None, typer.Option(help="folder for the table (default: runs/sweep-NAME)")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="processes (default: one a core)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the rows as JSON instead of the table")] = False,
) -> None:
    """Run a table of scenarios in-process: stability 1,920 runs, robustness 66, odometry 12."""
    if name not in SWEEPS:
        raise OmnibotError(f"no sweep {name!r}; there are: {', '.join(SWEEPS)}")
    folder = out or RUNS / f"sweep-{name}"
    total = sum(1 for _ in SWEEPS[name]())
    rows = list(until_ctrl_c(run_sweep(name, jobs), total, name))
    write_atomically(folder / "sweep.json", (json.dumps(rows, indent=2) + "\n").encode())
    write_atomically(folder / "sweep.md", table(rows).encode())
    print(json.dumps(rows, indent=2) if as_json else table(rows))  # noqa: T201
    lost = sum(row["status"] != "completed" for row in rows)
    print(f"{len(rows)} runs, {lost} not completed; table: {folder / 'sweep.md'}", file=sys.stderr)  # noqa: T201
    refuse_cut_short(len(rows), total, str(folder / "sweep.md"))


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
    folder = out or RUNS / "inject"
    cases, total = (restart_cases(restarts, seed), restarts) if restarts else (fault_cases(seed), len(FAULT_ROWS))
    rows = list(until_ctrl_c(run_cases(cases, jobs), total, "inject"))
    write_atomically(folder / "inject.json", (json.dumps(rows, indent=2) + "\n").encode())
    write_atomically(folder / "inject.md", table(rows).encode())
    print(json.dumps(rows, indent=2) if as_json else table(rows))  # noqa: T201
    wrong = [row for row in rows if not is_explained(row)]
    print(f"{len(rows)} drives, {len(wrong)} against a rule; table: {folder / 'inject.md'}", file=sys.stderr)  # noqa: T201
    refuse_cut_short(len(rows), total, str(folder / "inject.md"))
    if wrong:
        raise RunFailedError(
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
    result = SoakResult(seed)
    with watched("soak", 1.0, lambda: result.progress(duration, wall)), contextlib.suppress(KeyboardInterrupt):
        soak(duration, wall, result)
    ends = "".join(f"\n  {count:6d}  {end}" for end, count in result.ends.most_common())
    text = (
        f"{result.simulated_s:.0f} s simulated in {result.wall_s:.0f} s: {result.drives} drives, {result.frames_hit} "
        f"frames hit, largest torque {result.max_torque_Nm:.3g} N*m; after warming up the resident set "
        f"({result.peak_KiB_after_warm_up} KiB) grew by {result.peak_growth_KiB} KiB, Python's blocks by "
        f"{result.block_growth}{ends}"
    )
    print(json.dumps(result.as_dict(), indent=2) if as_json else text)  # noqa: T201
    if result.progress(duration, wall) < 1.0:
        raise CutShortError(f"interrupted after {result.simulated_s:.0f} s of simulated time")
    if result.problems:
        raise RunFailedError(f"{len(result.problems)} drives against a rule; the first: {result.problems[0]}")


@app.command(add_help_option=False, context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def cost(context: typer.Context) -> None:
    """Tell what a step costs on the target: instructions, cycles, stack, flash and RAM (omnibot cost --help)."""
    # The meter knows the firmware's symbols, this package does not: it is a tool of the source tree.
    raise typer.Exit(subprocess.run([sys.executable, COST_TOOL, *context.args], check=False).returncode)


@app.command("bench")
def run_bench(
    only: Annotated[
        str | None,
        typer.Option(
            help="comma-separated: plant, loop, vcan (default: all)", autocompletion=completion.some_of(*PARTS)
        ),
    ] = None,
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
