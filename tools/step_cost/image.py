"""What an ELF file says of itself: functions and where they lie, sizes by module, layouts of structs, source lines."""

from bisect import bisect_right
from functools import cached_property
from pathlib import Path

from elftools.elf.elffile import ELFFile

EXECUTABLE = 0x4


class Image:
    """An ELF file for the board."""

    def __init__(self, file: Path) -> None:
        self.file = file
        with file.open("rb") as opened:
            elf = ELFFile(opened)
            table = elf.get_section_by_name(".symtab")
            symbols = [s for s in table.iter_symbols() if s["st_info"]["type"] == "STT_FUNC" and s["st_size"] > 0]
            self.functions = {s.name: s["st_value"] & ~1 for s in symbols}
            self._extents = sorted((s["st_value"] & ~1, s["st_size"], s.name) for s in symbols)
            self._code = [
                (s["sh_addr"], s.data())
                for s in elf.iter_sections()
                if s["sh_flags"] & EXECUTABLE and s["sh_type"] == "SHT_PROGBITS"
            ]
        self._starts = [start for start, _, _ in self._extents]

    def function_at(self, address: int) -> str:
        """Return the function that an address lies in."""
        index = bisect_right(self._starts, address) - 1
        if index >= 0:
            start, size, name = self._extents[index]
            if address < start + size:
                return str(name)
        return f"{address:#010x}"

    def code(self, address: int, size: int) -> bytes:
        """Return bytes of an executable section."""
        for start, data in self._code:
            if start <= address < start + len(data):
                return bytes(data[address - start : address - start + size])
        raise ValueError(f"no code at {address:#010x} in {self.file}")

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
