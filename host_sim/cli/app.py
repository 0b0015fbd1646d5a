"""What all verbs share: the application, what they print and where they write."""

import itertools
import json
import shlex
import sys
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.text import Text

from host_sim.errors import OmnibotError

RUNS = Path("runs")  # where results go that were given no folder: below the one that the user is in

EPILOG = (
    "Exit codes: 0 done; 1 failed, or refused: the last line says why and what helps; 2 not a command of ours; "
    "130 ended by Ctrl-C: what there was by then is written."
)

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False, epilog=EPILOG)


@app.callback()
def omnibot() -> None:
    """Drive a simulated robot with slipping wheels by the firmware that goes to the board."""


class RunFailedError(OmnibotError):
    """A run that did not complete; its result was printed already."""


class CutShortError(RunFailedError):
    """What Ctrl-C ended; what there was of it was written and printed already."""


def refuse_uncompleted(result: Mapping[str, Any], folder: Path) -> None:
    """Say, of a run whose result was written and printed, why it did not complete."""
    if result["status"] == "interrupted":
        raise CutShortError(f"{result['reason']}; what was recorded until then is in {folder}")
    if result["status"] != "completed":
        raise RunFailedError(result["reason"])


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
    """Run the command line; an error that the user can cure is one line. The exit codes are those of the epilog."""
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # a terminal without our letters
    try:
        app(prog_name="omnibot")
    except (OmnibotError, OSError) as error:
        # Text, not markup: what the user typed may hold brackets.
        Console(stderr=True).print(Text.assemble(("omnibot:", "bold red"), f" {error}"), soft_wrap=True)
        if "--json" in sys.argv and not isinstance(error, RunFailedError):
            print(json.dumps({"status": "error", "reason": str(error)}))  # noqa: T201
        sys.exit(130 if isinstance(error, CutShortError) else 1)
