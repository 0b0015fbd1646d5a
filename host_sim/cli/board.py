"""Verbs for a board, and for the machine that it is at."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from host_sim.cli import completion
from host_sim.cli.app import CutShortError, RunFailedError, app
from host_sim.doctor import CHECKS, MAIN_JOB, Finding, as_dict, examine, text_of
from host_sim.flash import IMAGE_FILE, RUNNERS, flash


@app.command("flash")
def flash_board(
    runner: Annotated[
        str | None,
        typer.Option(
            help="openocd, st-flash, pyocd or dfu-util (default: the first that is installed)",
            autocompletion=completion.one_of(*(runner.program for runner in RUNNERS)),
        ),
    ] = None,
    image: Annotated[Path, typer.Option(help="what the flash shall hold")] = IMAGE_FILE,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only show the commands")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON, and what the tool says on stderr")] = False,
) -> None:
    """Write the firmware into a board's flash, verify it, and reset the board."""
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        typer.echo(line, err=as_json)

    try:
        flash(runner, image, dry_run, say)
    except KeyboardInterrupt:
        raise CutShortError("interrupted: the flash may hold a part of the image; flash the board again") from None
    if as_json:
        print(json.dumps({"status": "planned" if dry_run else "verified", "image": str(image), "said": said}, indent=2))  # noqa: T201
    elif not dry_run:
        print(f"flashed and verified: {image}")  # noqa: T201


@app.command("doctor")
def tell_what_works(
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of the lines")] = False,
) -> None:
    """Try what works here, and name for what does not the one command that helps.

    The exit code is 0 if the firmware can be run in-process, whatever else is missing.
    """
    findings: list[Finding] = []
    console = Console(highlight=False)
    for check in CHECKS:
        findings.append(examine(check))
        if not as_json:
            console.print(text_of(findings[-1]), soft_wrap=True)
    if as_json:
        print(json.dumps(as_dict(findings), indent=2))  # noqa: T201
    for finding in findings:
        if finding.name == MAIN_JOB and not finding.works:
            raise RunFailedError(f"the firmware cannot be run in-process: {finding.cure}")
