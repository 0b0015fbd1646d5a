#!/usr/bin/env python3
"""Write the tables of protocol/README.md from the DBC: generate_wire_tables.py DBC README [--check].

A table stands between ``<!-- wire: NAME -->`` and ``<!-- end -->``; NAME is ``messages``, ``load``, or a message. With
--check nothing is written, and tables that are not those of the DBC fail.
"""

import argparse
import re
import sys
from pathlib import Path

import cantools.database
from cantools.database.can import Database, Message, Signal

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from host_sim.busload import bus_load

BLOCK = re.compile(r"(?<=<!-- wire: )(\w+)( -->\n)(.*?)(?=<!-- end -->)", re.DOTALL)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


def messages_table(database: Database) -> str:
    """Return the overview: a row a message, highest priority first."""
    rows = []
    for message in sorted(database.messages, key=lambda m: m.frame_id):
        way = "host → robot" if message.senders == ["HOST"] else "robot → host"
        period = f"{message.cycle_time} ms" if message.cycle_time else "on request"
        purpose = message.comment or ""
        rows += [[f"0x{message.frame_id:03X}", message.name, way, str(message.length), period, purpose]]
    return table(["id at node 0", "message", "direction", "bytes", "period", "purpose"], rows)


def type_name(signal: Signal) -> str:
    """Return how the bits of a signal are read."""
    if signal.is_float:
        return "IEEE 754 single"
    return f"{'signed' if signal.is_signed else 'unsigned'} {signal.length}"


def range_text(signal: Signal) -> str:
    """Return the range of a signal in its unit."""
    if signal.is_float:
        return "any finite"
    if signal.is_signed:
        return f"±{signal.maximum:.9g}"
    return f"0 … {signal.maximum:.10g}"


def absent_text(signal: Signal) -> str:
    """Return how a signal says that it has no value."""
    if signal.is_float:
        return "NaN"
    return f"raw −{1 << (signal.length - 1)}" if signal.is_signed else "–"


def meaning(signal: Signal) -> str:
    """Return the value table or the comment of a signal."""
    choices = ", ".join(f"{value} {label}" for value, label in sorted((signal.choices or {}).items()))
    return choices or (signal.comment or "")


def signals_table(message: Message) -> str:
    """Return the signals of a message: a row a signal, in the order of their bits."""
    rows = []
    for signal in sorted(message.signals, key=lambda s: s.start):
        bits = f"{signal.start} … {signal.start + signal.length - 1}"
        step = "–" if signal.is_float else f"{signal.scale:g}"
        row = [signal.name, bits, type_name(signal), step, signal.unit or "–", range_text(signal), absent_text(signal)]
        rows += [[*row, meaning(signal)]]
    return table(["signal", "bits", "type", "LSB", "unit", "range", "not available", "values"], rows)


def load_text(database: Database) -> str:
    """Return the bus load of the closed loop."""
    load = bus_load(database.messages)
    frames = ", ".join(f"{frame.name} {frame.bits}" for frame in load.tick_frames)
    return (
        f"{len(load.tick_frames)} frames a tick: {frames}: **{load.bits_per_tick} bits** at the worst. With the slower "
        f"frames that is {load.load_fraction:.1%} of the bus at 1 Mbit/s and a tick of {load.tick_s * 1e3:g} ms.\n"
    )


def blocks(database: Database) -> dict[str, str]:
    """Return every table by its name."""
    made = {message.name: signals_table(message) for message in database.messages}
    return made | {"messages": messages_table(database), "load": load_text(database)}


def updated(text: str, database: Database) -> str:
    """Return the README with its tables made new; exits by name for a table too many or missing."""
    made = blocks(database)
    there = [found[1] for found in BLOCK.finditer(text)]
    if sorted(there) != sorted(made):
        wrong = ", ".join(sorted(set(there) ^ set(made))) or "one is there twice"
        sys.exit(f"tables and messages do not belong together: {wrong}")
    return BLOCK.sub(lambda found: f"{found[1]}{found[2]}\n{made[found[1]]}\n", text)


def main() -> None:
    """Write the tables, or check them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dbc", type=Path, help="wire definition")
    parser.add_argument("readme", type=Path, help="Markdown file with the marks")
    parser.add_argument("--check", action="store_true", help="write nothing; fail when the tables are stale")
    arguments = parser.parse_args()
    database = cantools.database.load_file(arguments.dbc)
    if not isinstance(database, Database):
        sys.exit(f"{arguments.dbc}: not a CAN database")
    text = arguments.readme.read_text(encoding="utf-8")
    new = updated(text, database)
    if arguments.check and new != text:
        sys.exit(f"{arguments.readme}: stale; tools/generate_wire_tables.py {arguments.dbc} {arguments.readme}")
    if not arguments.check:
        arguments.readme.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
