"""What a control step costs on the target, without a board.

Counted: instructions, every one of the firmware's own code, on an emulated Cortex-M4F. Estimated: cycles, by the model
in cycles.py, for memory without wait states; what the flash of a board adds is not in them.
"""

import argparse
import importlib.util
import json
import shlex
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]
for package in ("capstone", "elftools", "unicorn"):
    if importlib.util.find_spec(package) is None:
        sys.exit(f"omnibot cost: no Python package {package}: tools/setup run brings it")

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table as RichTable  # noqa: E402

from host_sim.errors import OmnibotError  # noqa: E402
from step_cost import budgets, page  # noqa: E402
from step_cost.corpus import ORDERS, OUTPUTS, SEED, TICK, sessions  # noqa: E402
from step_cost.equality import Equality  # noqa: E402
from step_cost.errors import CostError  # noqa: E402
from step_cost.image import Image  # noqa: E402
from step_cost.measure import Class, Measurement, Target, evaluate, run_session  # noqa: E402
from step_cost.profile import profile  # noqa: E402
from step_cost.result import collect  # noqa: E402
from step_cost.tables import tables  # noqa: E402

BUILD = ROOT / "build" / "target"
HOST = ROOT / "build" / "host"
MEASURED, BOARD = "step-cost.elf", "omnibot.elf"
BUDGETS = ROOT / "tests" / "bench" / "budgets.toml"
ANGLES = 20_000


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="omnibot cost", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--build", type=Path, default=BUILD, help="folder of the target build (default: build/target)")
    parser.add_argument("--host", type=Path, default=HOST, help="folder of the host build (default: build/host)")
    parser.add_argument("--budgets", type=Path, default=BUDGETS, help="default: tests/bench/budgets.toml")
    parser.add_argument("--json", action="store_true", help="print the result as JSON instead of tables")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of cost.json and report.html (default: a new one below runs/)",
    )
    parser.add_argument(
        "--use", type=Path, metavar="FILE", help="figures of an earlier run, its cost.json; measure nothing"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--check", action="store_true", help="fail when a figure is above its budget")
    what.add_argument("--update", action="store_true", help="make today's figures the budgets")
    what.add_argument("--profile", choices=ORDERS, metavar="ORDER", help="where the cycles of a step go")
    what.add_argument("--equality", action="store_true", help="compare target and host bit for bit instead")
    parser.add_argument("--tick", action="store_true", help="of --profile: the whole tick, frames and all")
    parser.add_argument("--output", choices=OUTPUTS, default=OUTPUTS[0], help="of --profile: posture or point")
    return parser.parse_args()


def measured(image: Image, orders: tuple[str, ...] = ORDERS) -> tuple[Target, Measurement]:
    """Run the corpus, or what of it concerns some orders."""
    target, measurement = Target(image), Measurement()
    for session in sessions(orders):
        run_session(target, session, measurement)
    evaluate(target, measurement)
    return target, measurement


def show_profile(image: Image, order: str, output: str, whole_tick: bool) -> None:
    """Print where the cycles of the costliest step or tick go."""
    target, measurement = measured(image, (order,))
    for table in profile(target.blocks, measurement.paths[Class(order, output), TICK], whole_tick):
        Console().print(table)


def show_equality(image: Image, host: Path) -> None:
    """Compare target and host, and say how much was compared."""
    equality = Equality(image, host)
    equality.trigonometry(ANGLES, np.random.default_rng(SEED))
    for session in sessions():
        equality.session(session)
    same = equality.compared
    print(
        f"identical, bit for bit: {same.frames} frames and the firmware's memory behind {same.groups} groups of them, "
        f"output and state of {same.control_steps} control steps, {same.angles} angles"
    )


def show_tables(result: dict[str, Any]) -> None:
    """Print the result for people."""
    console = Console()
    for table in tables(result):
        shown = RichTable(*table.head, title=table.title, title_justify="left")
        for row in table.rows:
            shown.add_row(*row)
        console.print(shown)
    console.print(f"Counted: {result['counted']}.\nEstimated: {result['estimated']}.\nBuilt by {result['compiler']}.")


def whole_result(build: Path) -> dict[str, Any]:
    """Measure all there is."""
    board = build / BOARD
    return collect(*measured(Image(build / MEASURED)), build, Image(board) if board.exists() else None)


def earlier_result(file: Path) -> dict[str, Any]:
    """Return the figures of an earlier run."""
    try:
        return dict(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise CostError(
            f"cannot read the figures {file}: {error}; omnibot cost --out DIR writes DIR/cost.json"
        ) from error


def tell(result: dict[str, Any], options: argparse.Namespace) -> None:
    """Print and write the result, and hold it to the budgets."""
    folder = options.out
    if folder is None and not (options.check or options.update):
        folder = Path("runs") / f"{datetime.now().astimezone():%Y-%m-%d-%H%M%S}-cost"
    if folder is not None:
        limits, command = budgets.cycle_limits(options.budgets), shlex.join(["omnibot", "cost", *sys.argv[1:]])
        print(f"report: {page.write(folder, result, limits, command)}", file=sys.stderr)
    if options.json:
        print(json.dumps(result, indent=2))
    elif not (options.check or options.update):
        show_tables(result)
    if options.update:
        budgets.update(result, options.budgets)
        print(f"budgets written: {options.budgets}", file=sys.stderr)
    if options.check:
        print(budgets.check(result, options.budgets), file=sys.stderr)


def main() -> int:
    """Run the command line; an error that the user can cure is one message and exit code 1."""
    options = arguments()
    try:
        if options.profile is not None:
            show_profile(Image(options.build / MEASURED), options.profile, options.output, options.tick)
        elif options.equality:
            show_equality(Image(options.build / MEASURED), options.host)
        else:
            tell(whole_result(options.build) if options.use is None else earlier_result(options.use), options)
    except (OmnibotError, OSError) as error:
        print(f"omnibot cost: {error}", file=sys.stderr)
        if options.json and not isinstance(error, budgets.BudgetError):
            print(json.dumps({"status": "error", "reason": str(error)}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
