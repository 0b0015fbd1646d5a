"""What a control step costs on the target: ``tools/step_cost`` prints it, without a board.

Counted: instructions, on an emulated Cortex-M4F, every one of the firmware's own. Estimated: cycles, by the model in
cycles.py, for memory without wait states; what the flash of a board adds is not in them.
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from rich.console import Console  # noqa: E402

from step_cost.corpus import ORDERS, TICK, sessions  # noqa: E402
from step_cost.image import Image  # noqa: E402
from step_cost.measure import Class, Measurement, Target, evaluate, run_session  # noqa: E402
from step_cost.profile import profile  # noqa: E402
from step_cost.show import table  # noqa: E402

IMAGE = ROOT / "build" / "target" / "step-cost.elf"


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="tools/step_cost", description=__doc__)
    parser.add_argument("--image", type=Path, default=IMAGE, help="default: build/target/step-cost.elf")
    parser.add_argument("--profile", choices=ORDERS, metavar="ORDER", help="where the cycles of a step of an order go")
    parser.add_argument("--output", default="posture", help="of the profile: posture or point")
    arguments = parser.parse_args()
    if not arguments.image.exists():
        print(f"step_cost: no {arguments.image}: tools/build target makes it", file=sys.stderr)
        return 1
    target, measurement = Target(Image(arguments.image)), Measurement()
    for session in sessions(ORDERS if arguments.profile is None else (arguments.profile,)):
        run_session(target, session, measurement.paths)
    evaluate(target, measurement)
    console = Console()
    if arguments.profile is None:
        console.print(table(measurement))
    else:
        paths = measurement.paths[Class(arguments.profile, arguments.output), TICK]
        for part in profile(target.blocks, paths):
            console.print(part)
    return 0


if __name__ == "__main__":
    sys.exit(main())
