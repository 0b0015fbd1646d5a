"""The command line: ``omnibot VERB``. Each module holds a family of verbs, told by ``--help`` in this order."""

import sys

try:
    # isort: off
    from host_sim.cli.app import app, main
    from host_sim.cli import drive, monitor, step, param, log, study, board
    # isort: on
except ModuleNotFoundError as error:
    if error.name is None or error.name.startswith("host_sim"):
        raise
    sys.exit(f"omnibot: no Python package {error.name}: tools/setup run brings it")

__all__ = ["app", "board", "drive", "log", "main", "monitor", "param", "step", "study"]
