"""What all verbs share: the application, what they print and where they write."""

import itertools
import json
import shlex
import sys
from datetime import datetime
from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from host_sim.errors import OmnibotError

RUNS = Path("runs")  # where results go that were given no folder: below the one that the user is in

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


@app.callback()
def omnibot() -> None:
    """Drive a simulated robot with slipping wheels by the firmware that goes to the board."""


class RunFailedError(OmnibotError):
    """A run that did not complete; its result was printed already."""


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


def new_folder(name: str) -> Path:
    """Return a folder below runs/ that no other run has."""
    stem = f"{datetime.now().astimezone():%Y-%m-%d-%H%M%S}-{name}"
    candidates = (RUNS / (stem if number == 0 else f"{stem}-{number}") for number in itertools.count())
    return next(folder for folder in candidates if not folder.exists())


def command_line() -> str:
    """Return the command that was typed."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


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
