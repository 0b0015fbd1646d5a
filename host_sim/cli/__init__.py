"""The command line: ``omnibot VERB``. Each module holds a family of verbs, told by ``--help`` in this order."""

# isort: off
from host_sim.cli.app import app, main
from host_sim.cli import drive, monitor, step, param, log, study, board
# isort: on

__all__ = ["app", "board", "drive", "log", "main", "monitor", "param", "step", "study"]
