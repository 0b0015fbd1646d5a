"""Which items there are, and how they are computed and written."""

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from host_sim.errors import OmnibotError
from host_sim.paper.cost import fig3b
from host_sim.paper.curves import fig2
from host_sim.paper.deviation import fig5, table1
from host_sim.paper.fast_variable import fig4
from host_sim.paper.page import paper_page
from host_sim.paper.section import Section
from host_sim.paper.simulate import Simulator
from host_sim.paper.stability import fig3a
from host_sim.report import PAGE_NAME
from host_sim.robot import Robot
from host_sim.run import run_folder
from host_sim.trace import write_atomically

JSON_NAME = "paper.json"

# In the order of the paper.
ITEMS: dict[str, Callable[[Simulator], Section]] = {
    "fig2": fig2,
    "fig3a": fig3a,
    "fig3b": fig3b,
    "fig4": fig4,
    "fig5": fig5,
    "table1": table1,
}


def choose(only: str | None) -> list[str]:
    """Return the items that a comma-separated list names, all without one, in the order of the paper."""
    if only is None:
        return list(ITEMS)
    wanted = [name.strip() for name in only.split(",")]
    for name in wanted:
        if name not in ITEMS:
            raise OmnibotError(f"--only: the paper has no {name!r} to show; there are: {', '.join(ITEMS)}")
    return [name for name in ITEMS if name in wanted]


def write_paper(
    names: list[str], robot: Robot, folder: Path, command: str, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Compute items and write ``report.html`` and ``paper.json``; returns what the latter holds.

    Ctrl-C ends it with the items that were done by then; ``missing`` names the others.

    Parameters
    ----------
    names
        Of ``ITEMS``.
    robot
        The robot that is driven.
    folder
        Where to write; refused, if it cannot be written, before anything runs.
    command
        The command that repeats it.
    progress
        Called with a line for each item.
    """
    simulator = Simulator(robot)
    sections: dict[str, Section] = {}
    with run_folder(folder):
        with contextlib.suppress(KeyboardInterrupt):
            for count, name in enumerate(names, start=1):
                section = ITEMS[name](simulator)
                sections[name] = section
                progress(f"{count}/{len(names)} {name}: paper {section.paper}; ours {section.ours}")
        numbers: dict[str, Any] = {
            key: value for section in sections.values() for key, value in section.numbers.items()
        }
        missing = [name for name in names if name not in sections]
        numbers |= {"missing": missing} if missing else {}
        text = json.dumps(numbers, indent=2, allow_nan=False) + "\n"
        write_atomically(folder / JSON_NAME, text.encode())
        write_atomically(folder / PAGE_NAME, paper_page(sections, command).encode())
    return numbers
