"""Verbs for a board."""

from pathlib import Path
from typing import Annotated

import typer

from host_sim.cli.app import app
from host_sim.flash import IMAGE_FILE, flash


@app.command("flash")
def flash_board(
    runner: Annotated[
        str | None, typer.Option(help="openocd, st-flash, pyocd or dfu-util (default: the first that is installed)")
    ] = None,
    image: Annotated[Path, typer.Option(help="what the flash shall hold")] = IMAGE_FILE,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only show the commands")] = False,
) -> None:
    """Write the firmware into a board's flash, verify it, and reset the board."""
    flash(runner, image, dry_run, typer.echo)
    if not dry_run:
        print(f"flashed and verified: {image}")  # noqa: T201
