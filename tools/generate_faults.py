#!/usr/bin/env python3
"""Make tables of firmware/app/faults.toml.

generate_faults.py FAULTS DBC OUTPUT_FOLDER writes fault_table.h and fault_table.c; generate_faults.py FAULTS DBC README
[--check] writes the table between ``<!-- faults -->`` and ``<!-- end -->`` of a page. The names and their order are
those of the DBC's STATUS.fault, or nothing is made.
"""

import re
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import cantools.database
from cantools.database.can import Database

REACTIONS = {"brake": "REACTION_BRAKE", "cut": "REACTION_CUT"}
NOTE = "// Generated from {source} by tools/generate_faults.py; do not edit.\n"
BLOCK = re.compile(r"<!-- faults -->\n.*?<!-- end -->", re.DOTALL)


class Fault(NamedTuple):
    """One fault: see the file."""

    name: str
    when: str
    ticks: int
    reaction: str


def load(path: Path) -> list[Fault]:
    """Read the faults in order."""
    faults = [Fault(**entry) for entry in tomllib.loads(path.read_text(encoding="utf-8"))["fault"]]
    for fault in faults:
        if fault.reaction not in REACTIONS:
            sys.exit(f"{path}: {fault.name}: reaction {fault.reaction!r} must be one of {', '.join(REACTIONS)}")
    return faults


def check_names(faults: list[Fault], dbc: Path) -> None:
    """Refuse faults that are not those of the wire."""
    database = cantools.database.load_file(dbc)
    assert isinstance(database, Database)
    choices = database.get_message_by_name("STATUS").get_signal_by_name("fault").choices
    of_wire = [str(label) for _, label in sorted((choices or {}).items())][1:]
    if of_wire != [fault.name for fault in faults]:
        sys.exit(f"the faults must be those of STATUS.fault in {dbc}, in its order: {', '.join(of_wire)}")


def c_header(faults: list[Fault]) -> str:
    """Return fault_table.h."""
    return (
        "#ifndef OMNIBOT_FAULT_TABLE_H\n#define OMNIBOT_FAULT_TABLE_H\n\n#include <stdint.h>\n\n"
        f"enum {{ FAULT_COUNT = {len(faults) + 1} }}; // NONE among them\n\n"
        "typedef struct {\n    uint8_t reaction; // of the wire: REACTION_ and a name\n"
        "    uint16_t detection_ticks; // from its cause to its coming up, with default parameters\n"
        "} fault_description_t;\n\nextern const fault_description_t fault_table[FAULT_COUNT];\n\n#endif\n"
    )


def c_source(faults: list[Fault]) -> str:
    """Return fault_table.c."""
    rows = "".join(f"    [FAULT_{f.name}] = {{{REACTIONS[f.reaction]}, {f.ticks}}},\n" for f in faults)
    return (
        '#include "fault_table.h"\n\n#include "messages.h"\n\n'
        f"const fault_description_t fault_table[FAULT_COUNT] = {{\n{rows}}};\n"
    )


def page_table(faults: list[Fault]) -> str:
    """Return the table for people."""
    lines = ["| fault | when | found after | then |", "| --- | --- | --- | --- |"]
    for number, fault in enumerate(faults, start=1):
        ticks = f"{fault.ticks} ticks" if fault.ticks else "the same tick"
        lines += [f"| {number} {fault.name} | {fault.when} | {ticks} | {fault.reaction} |"]
    return "<!-- faults -->\n\n" + "\n".join(lines) + "\n\n<!-- end -->"


def write_page(page: Path, faults: list[Fault], only_check: bool) -> None:
    """Put the table into its place, or see that it is there."""
    text = page.read_text(encoding="utf-8")
    made, places = BLOCK.subn(lambda _: page_table(faults), text)
    if places != 1:
        sys.exit(f"{page}: must have one <!-- faults --> … <!-- end -->")
    if only_check and made != text:
        sys.exit(f"{page}: its table is not that of the faults; tools/generate_faults.py FAULTS DBC {page} writes it")
    if not only_check:
        page.write_text(made, encoding="utf-8")


def main() -> None:
    """Do what the command line says."""
    arguments = [argument for argument in sys.argv[1:] if argument != "--check"]
    if len(arguments) != 3:
        sys.exit("usage: generate_faults.py FAULTS DBC OUTPUT_FOLDER|README [--check]")
    source, dbc, output = map(Path, arguments)
    faults = load(source)
    check_names(faults, dbc)
    if output.suffix == ".md":
        write_page(output, faults, "--check" in sys.argv)
        return
    note = NOTE.format(source=source.name)
    output.mkdir(parents=True, exist_ok=True)
    (output / "fault_table.h").write_text(note + c_header(faults), encoding="utf-8")
    (output / "fault_table.c").write_text(note + c_source(faults), encoding="utf-8")


if __name__ == "__main__":
    main()
