"""The verb that tries the gains: a step response beside the poles that they promise."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from host_sim.bus_choice import choose_bus
from host_sim.cli.app import app, command_line, new_folder, parse_numbers, parse_settings, refuse_uncompleted
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
from host_sim.cli.drive import EpsilonOption, OrderOption, OutputOption, PlantOption, SettingOption, TractionOption
from host_sim.cli.text import columns
from host_sim.codec import DBC_FILE, Codec
from host_sim.link import open_bus
from host_sim.planner import PathRequest
from host_sim.report.step import write_step
from host_sim.robot import load_robot
from host_sim.run import LOG_FILE, BusLog, run_folder
from host_sim.scenario import Scenario
from host_sim.step import Step, run_step, stepped, table_rows


def _table(result: dict[str, Any]) -> str:
    """Return the figures, and what they do not hold for."""
    lines = [columns(table_rows(result["outputs"]))]
    share = result["bounds"]["fraction_at_bound"]
    if share > 0.0:
        lines.append(
            f"a bound of force or torque acted in {100.0 * share:.2g} % of the ticks, where no linear law holds: "
            "a smaller offset stays below it"
        )
    return "\n".join(lines)


@app.command()
def step(
    p1: Annotated[float, typer.Option(help="offset of the tracked point along the first axis, m")] = 0.02,
    p2: Annotated[float, typer.Option(help="offset of the tracked point along the second axis, m")] = 0.0,
    heading: Annotated[
        float | None, typer.Option(help="offset of the heading, rad (default: 0.1, or 0 with --output point)")
    ] = None,
    speed: Annotated[float, typer.Option(help="speed of the reference along the first axis, m/s")] = 0.0,
    duration: Annotated[float | None, typer.Option(help="s (default: as the slowest pole needs)")] = None,
    epsilon: EpsilonOption = 0.01,
    order: OrderOption = "observer",
    output: OutputOption = "posture",
    traction: TractionOption = "magic",
    setting: SettingOption = None,
    plant: PlantOption = None,
    bus: BusOption = "inproc",
    interface: InterfaceOption = None,
    channel: ChannelOption = None,
    bitrate: BitrateOption = None,
    node: NodeOption = 0,
    timeout: TimeoutOption = 2.0,
    dbc: DbcOption = DBC_FILE,
    out: Annotated[Path | None, typer.Option(help="folder of the results (default: a new one below runs/)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print step.json instead of the table")] = False,
) -> None:
    """Start beside the reference and hold the way back against the poles that K1 and K2 promise.

    Writes trace.npz, step.json, bus.log and report.html. Gains are tuned with --set: position_stiffness_per_s2 and
    position_damping_per_s are K1 and K2 of p1 and p2, heading_… those of the heading.
    """
    check_timeout(timeout)
    robot = load_robot()
    turn = heading if heading is not None else 0.0 if output == "point" else 0.1
    asked = Step((p1, p2, turn), speed, duration)
    scenario = Scenario(
        path=PathRequest("line", 0.5),  # not driven: a step has a reference of its own
        epsilon=epsilon,
        order=order,
        output=output,
        traction=traction,  # type: ignore[arg-type]  # checked by Traction
        parameters=parse_settings("--set", setting or []),
        plant=parse_numbers("--plant", plant or []),
    )
    scenario.traction_of(scenario.plant_robot(robot))
    stepped(scenario, asked, robot)
    codec, folder = Codec(dbc, node), out or new_folder("step")
    label = choose_bus(bus, interface, channel, bitrate).label
    with open_bus(bus, node, interface, channel, bitrate) as opened, run_folder(folder):
        log = BusLog(folder / LOG_FILE, channel="vcan0")
        try:
            run = run_step(scenario, asked, robot, link_on(opened, codec, timeout, log.record))
        finally:
            log.close()
        run.result["scenario"] |= {"bus": label, "command": command_line()}
        page = write_step(folder, run, command_line())
    print(json.dumps(run.result, indent=2) if as_json else f"{_table(run.result)}\nreport: {page}")  # noqa: T201
    refuse_uncompleted(run.result, folder)
