#!/usr/bin/env python3
"""Write the C codec of protocol/omnibot.dbc: generate_codec.py DBC OUTPUT_FOLDER.

One struct, one encode and one decode function a message, on explicit shifts of two 32-bit words. Physical signals
(scaled or signed) are float fields in SI units; plain unsigned ones are integers. A signal called ``crc`` is no field:
encode fills it in, decode checks it.
"""

import sys
import zlib
from pathlib import Path

import cantools.database
from cantools.database.can import Database, Message, Signal

HEADER = """\
// Generated from {source} by tools/generate_codec.py; do not edit.
#ifndef OMNIBOT_MESSAGES_H
#define OMNIBOT_MESSAGES_H

#include "frame.h"

#include <stdbool.h>
#include <stdint.h>

// CRC-32 of the DBC file: peers that disagree on it refuse to drive.
#define PROTOCOL_HASH 0x{hash:08X}u

typedef enum {{ DECODE_OK, DECODE_WRONG_LENGTH, DECODE_WRONG_CRC }} decode_result_t;

"""


def is_physical(signal: Signal) -> bool:
    """Tell whether a signal becomes a float field."""
    return signal.is_float or signal.is_signed or signal.scale != 1


def fields(message: Message) -> list[Signal]:
    """Return the signals that are fields of the struct."""
    return [signal for signal in message.signals if signal.name != "crc"]


def has_crc(message: Message) -> bool:
    """Tell whether the message ends in a checksum."""
    return any(signal.name == "crc" for signal in message.signals)


def c_type(signal: Signal) -> str:
    """Return the C type of a field."""
    if is_physical(signal):
        return "float"
    return next(f"uint{bits}_t" for bits in (8, 16, 32) if signal.length <= bits)


def check(message: Message) -> None:
    """Refuse what the generated shifts cannot carry."""
    for signal in message.signals:
        if signal.byte_order != "little_endian" or signal.length > 32 or signal.offset != 0:
            sys.exit(f"{message.name}.{signal.name}: must be little-endian, at most 32 bits, offset 0")
        if signal.name == "crc" and (signal.length != 8 or signal.start != 8 * (message.length - 1)):
            sys.exit(f"{message.name}.crc: must be the whole last byte")
        if is_physical(signal) and not signal.is_float and not signal.is_signed:
            sys.exit(f"{message.name}.{signal.name}: a scaled signal must be signed")


def enumeration(prefix: str, signal: Signal) -> str:
    """Return the C enum of a signal's value table."""
    names = ", ".join(f"{prefix}_{label} = {value}" for value, label in sorted((signal.choices or {}).items()))
    return f"enum {{ {names} }};\n"


def struct(message: Message) -> str:
    """Return the struct of a message, each field with its unit or meaning."""
    name = message.name.lower()
    lines = [f"// {message.comment}"] if message.comment else []
    lines += ["typedef struct {"]
    lines += [f"    {c_type(s)} {s.name};" + (f" // {s.comment}" if s.comment else "") for s in fields(message)]
    lines += [f"}} {name}_message_t;", ""]
    lines += [
        f"enum {{ {message.name}_FUNCTION = {message.frame_id >> 4}, {message.name}_LENGTH = {message.length} }};"
    ]
    lines += [f"void {name}_encode(frame_t *frame, uint8_t node, const {name}_message_t *message);"]
    lines += [f"decode_result_t {name}_decode({name}_message_t *message, const frame_t *frame);", ""]
    return "\n".join(lines)


def c_float(value: float) -> str:
    """Return a C literal of single precision."""
    text = f"{value:.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def raw_max(signal: Signal) -> int:
    """Return the largest raw value of a signed signal; the one below its negative means 'not available'."""
    return int(2 ** (signal.length - 1) - 1)


def to_raw(signal: Signal) -> str:
    """Return the C expression of a field's raw bits."""
    field = f"message->{signal.name}"
    if signal.is_float:
        return f"wire_float_bits({field})"
    mask = (1 << signal.length) - 1
    if is_physical(signal):
        steps_per_unit = c_float(1.0 / float(signal.scale))
        return f"(uint32_t)wire_quantise({field}, {steps_per_unit}, {raw_max(signal)}) & 0x{mask:X}u"
    return f"{field}" if signal.length == 32 else f"{field} & 0x{mask:X}u"


def encode(message: Message) -> str:
    """Return the encode function of a message."""
    name = message.name.lower()
    lines = [f"void {name}_encode(frame_t *frame, uint8_t node, const {name}_message_t *message)", "{"]
    lines += ["    uint32_t word[2] = {0u, 0u};"]
    for signal in fields(message):
        lines += [f"    const uint32_t {signal.name} = {to_raw(signal)};"]
        word, shift = divmod(signal.start, 32)
        lines += [f"    word[{word}] |= {signal.name}{f' << {shift}' if shift else ''};"]
        if shift + signal.length > 32:
            lines += [f"    word[1] |= {signal.name} >> {32 - shift};"]
    lines += [
        f"    frame->id = (uint16_t)({message.name}_FUNCTION << FRAME_NODE_BITS | (node & FRAME_NODE_MASK));",
        f"    frame->length = {message.name}_LENGTH;",
        "    wire_store(&frame->data[0], word[0]);",
        "    wire_store(&frame->data[4], word[1]);",
    ]
    if has_crc(message):
        last = f"{message.name}_LENGTH - 1"
        lines += [f"    frame->data[{last}] = crc8_frame(frame, {last});"]
    return "\n".join([*lines, "}", ""])


def from_raw(signal: Signal) -> str:
    """Return the C expression of a field from its raw bits."""
    if signal.is_float:
        return f"wire_float({signal.name})"
    if is_physical(signal):
        sign = f"0x{1 << (signal.length - 1):X}u"
        return (
            f"wire_physical(wire_sign_extend({signal.name}, {sign}), {c_float(float(signal.scale))}, {raw_max(signal)})"
        )
    return f"({c_type(signal)}){signal.name}"


def bits(signal: Signal) -> str:
    """Return the C expression that takes a signal's raw bits out of the words."""
    word, shift = divmod(signal.start, 32)
    value = f"word[{word}] >> {shift}" if shift else f"word[{word}]"
    if shift + signal.length > 32:
        value = f"({value} | word[1] << {32 - shift})"
    if signal.length == 32:
        return value
    return f"({value}) & 0x{(1 << signal.length) - 1:X}u"


def decode(message: Message) -> str:
    """Return the decode function of a message."""
    name = message.name.lower()
    lines = [f"decode_result_t {name}_decode({name}_message_t *message, const frame_t *frame)", "{"]
    lines += [f"    if (frame->length != {message.name}_LENGTH) {{", "        return DECODE_WRONG_LENGTH;", "    }"]
    if has_crc(message):
        last = f"{message.name}_LENGTH - 1"
        lines += [f"    if (frame->data[{last}] != crc8_frame(frame, {last})) {{"]
        lines += ["        return DECODE_WRONG_CRC;", "    }"]
    lines += ["    const uint32_t word[2] = {wire_load(&frame->data[0]), wire_load(&frame->data[4])};"]
    for signal in fields(message):
        lines += [f"    const uint32_t {signal.name} = {bits(signal)};"]
        lines += [f"    message->{signal.name} = {from_raw(signal)};"]
    return "\n".join([*lines, "    return DECODE_OK;", "}", ""])


def enumerations(database: Database) -> str:
    """Return an enum for each value table: MODE_…, or MESSAGE_… where the signal is called result."""
    made: dict[str, str] = {}
    for message in database.messages:
        for signal in message.signals:
            if signal.choices:
                prefix = f"{message.name}_RESULT" if signal.name == "result" else signal.name.upper()
                text = enumeration(prefix, signal)
                if made.setdefault(prefix, text) != text:
                    sys.exit(f"{message.name}.{signal.name}: two different value tables are called {prefix}")
    return "".join(made.values()) + "\n"


def main() -> None:
    """Generate messages.h and messages.c."""
    if len(sys.argv) != 3:
        sys.exit("usage: generate_codec.py DBC OUTPUT_FOLDER")
    source, folder = Path(sys.argv[1]), Path(sys.argv[2])
    database = cantools.database.load_file(source)
    if not isinstance(database, Database):
        sys.exit(f"{source}: not a CAN database")
    for message in database.messages:
        check(message)
    # Line ends are a matter of the checkout, not of the wire.
    digest = zlib.crc32(source.read_bytes().replace(b"\r\n", b"\n"))
    header = HEADER.format(source=source.name, hash=digest) + enumerations(database)
    header += "\n".join(struct(message) for message in database.messages) + "#endif\n"
    body = f"// Generated from {source.name} by tools/generate_codec.py; do not edit.\n"
    body += '#include "messages.h"\n\n#include "crc.h"\n#include "wire.h"\n\n'
    body += "\n".join(encode(m) + "\n" + decode(m) for m in database.messages)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "messages.h").write_text(header, encoding="utf-8")
    (folder / "messages.c").write_text(body, encoding="utf-8")


if __name__ == "__main__":
    main()
