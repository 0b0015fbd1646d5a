"""What an ELF file for the board says of itself: functions and constants, where they lie, sizes, source lines."""

from bisect import bisect_right
from collections import Counter
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile

from step_cost.errors import CostError

WRITABLE, ALLOCATED, EXECUTABLE = 0x1, 0x2, 0x4
NO_SOURCE = "C library"
STACK_SECTION = ".stack"


class ImageError(CostError):
    """An ELF file that does not hold what it should."""


def _unique(symbols: list[Any]) -> dict[str, Any]:
    """Return symbols by name; statics of the same name by name and address."""
    names = Counter(symbol.name for symbol in symbols)
    return {s.name if names[s.name] == 1 else f"{s.name}@{s['st_value'] & ~1:08x}": s for s in symbols}


class Image:
    """An ELF file for the board."""

    def __init__(self, file: Path) -> None:
        self.file = file
        if not file.exists():
            raise ImageError(f"no {file}: tools/setup test brings its compiler, tools/build target makes it")
        with file.open("rb") as opened:
            elf = ELFFile(opened)
            table = elf.get_section_by_name(".symtab")
            if table is None:
                raise ImageError(f"{file} has no symbols: it must not be stripped")
            symbols = [symbol for symbol in table.iter_symbols() if symbol["st_size"] > 0]
            self._marks = sorted(
                (symbol["st_value"], symbol.name[:2])
                for symbol in table.iter_symbols()
                if symbol.name[:2] in ("$t", "$d")
            )
            sections = [section for section in elf.iter_sections() if section["sh_flags"] & ALLOCATED]
            self._contents = [(s["sh_addr"], s.data()) for s in sections if s["sh_type"] == "SHT_PROGBITS"]
            self.flash_bytes = sum(s["p_filesz"] for s in elf.iter_segments() if s["p_type"] == "PT_LOAD")
            writable = [section for section in sections if section["sh_flags"] & WRITABLE]
            # What a linker script keeps free for the stack says nothing of how much is needed.
            self.variables_bytes = sum(section["sh_size"] for section in writable if section.name != STACK_SECTION)
        functions = _unique([s for s in symbols if s["st_info"]["type"] == "STT_FUNC"])
        objects = _unique([s for s in symbols if s["st_info"]["type"] == "STT_OBJECT"])
        self.functions = {name: symbol["st_value"] & ~1 for name, symbol in functions.items()}
        self.objects = {name: (symbol["st_value"], symbol["st_size"]) for name, symbol in objects.items()}
        self._extents = sorted((s["st_value"] & ~1, s["st_size"], name) for name, s in functions.items())
        self._starts = [start for start, _, _ in self._extents]

    def function(self, name: str) -> int:
        """Return the address of a function that must be there."""
        if name not in self.functions:
            raise ImageError(f"{self.file} has no function {name}")
        return int(self.functions[name])

    def function_at(self, address: int) -> str:
        """Return the function that an address lies in."""
        index = bisect_right(self._starts, address) - 1
        if index >= 0:
            start, size, name = self._extents[index]
            if address < start + size:
                return str(name)
        return f"{address:#010x}"

    def size_of(self, function: str) -> int:
        """Return the bytes of a function, its constants included."""
        return next(int(size) for _, size, name in self._extents if name == function)

    def data(self, address: int, size: int) -> bytes:
        """Return bytes of code or constants."""
        for start, data in self._contents:
            if start <= address < start + len(data):
                return bytes(data[address - start : address - start + size])
        raise ImageError(f"{self.file} has nothing at {address:#010x}")

    def code_ranges(self, address: int) -> list[tuple[int, int]]:
        """Return begin and end of each piece of instructions in the function at an address, without its constants."""
        start, size, _ = self._extents[bisect_right(self._starts, address) - 1]
        inside = [(at, mark) for at, mark in self._marks if start < at < start + size]
        before = [mark for at, mark in self._marks if at <= start]
        edges = [(start, before[-1]), *inside, (start + size, "")]
        pieces = pairwise(edges)
        return [(begin, end) for (begin, mark), (end, _) in pieces if mark == "$t" and end > begin]

    @cached_property
    def lines(self) -> dict[int, str]:
        """Source file and line of each address that starts a line."""
        found: dict[int, str] = {}
        with self.file.open("rb") as opened:
            dwarf = ELFFile(opened).get_dwarf_info()
            for unit in dwarf.iter_CUs():
                program = dwarf.line_program_for_CU(unit)
                files = program["file_entry"]
                first = 0 if program["version"] >= 5 else 1
                for entry in program.get_entries():
                    if entry.state is not None and not entry.state.end_sequence:
                        name = files[entry.state.file - first].name.decode()
                        found[entry.state.address] = f"{name}:{entry.state.line}"
        return found

    @cached_property
    def _line_starts(self) -> list[int]:
        return sorted(self.lines)

    def line_at(self, address: int) -> str:
        """Return 'file:line' of an instruction."""
        index = bisect_right(self._line_starts, address) - 1
        return self.lines[self._line_starts[index]] if index >= 0 else "?"

    @cached_property
    def compiler(self) -> str:
        """Name and version of the compiler that made most of it."""
        with self.file.open("rb") as opened:
            tops = [unit.get_top_DIE().attributes for unit in ELFFile(opened).get_dwarf_info().iter_CUs()]
        producers = (top["DW_AT_producer"].value.decode() for top in tops if "DW_AT_producer" in top)
        return str(Counter(producer.partition(" -")[0] for producer in producers).most_common(1)[0][0])

    @cached_property
    def modules(self) -> dict[str, Counter[str]]:
        """Bytes by source file: 'code', 'constants' and 'variables'."""
        sources = self._sources()
        found: dict[str, Counter[str]] = {}
        for start, size, _ in self._extents:
            found.setdefault(sources.get(start, NO_SOURCE), Counter())["code"] += size
        for start, size in self.objects.values():
            kind = "constants" if any(at <= start < at + len(data) for at, data in self._contents) else "variables"
            found.setdefault(sources.get(start, NO_SOURCE), Counter())[kind] += size
        return found

    def _sources(self) -> dict[int, str]:
        """Return the source file of each function and object, by address."""
        found: dict[int, str] = {}
        with self.file.open("rb") as opened:
            for unit in ELFFile(opened).get_dwarf_info().iter_CUs():
                top = unit.get_top_DIE()
                name = Path(top.attributes["DW_AT_name"].value.decode()).name
                for die in unit.iter_DIEs():
                    address = _address(die)
                    if address is not None:
                        found[address] = name
        return found


def _address(die: Any) -> int | None:
    """Return where a function or a variable lies."""
    if die.tag == "DW_TAG_subprogram" and "DW_AT_low_pc" in die.attributes:
        return int(die.attributes["DW_AT_low_pc"].value) & ~1
    location = die.attributes.get("DW_AT_location")
    if die.tag == "DW_TAG_variable" and location is not None and location.form == "DW_FORM_exprloc":
        code = bytes(location.value)
        if len(code) == 5 and code[0] == 0x03:  # DW_OP_addr
            return int.from_bytes(code[1:], "little")
    return None
