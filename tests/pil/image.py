"""The board's image taken apart: symbols, memory, and copies of it with other instructions in them."""

import subprocess
from pathlib import Path

from elftools.elf.elffile import ELFFile

from host_sim.robot import ROOT

IMAGE_FILE = ROOT / "build" / "target" / "omnibot.elf"  # as it comes; build/board may be another board's or node's


class Image:
    """An ELF file of the board."""

    def __init__(self, path: Path = IMAGE_FILE) -> None:
        self.path = path
        with path.open("rb") as file:
            elf = ELFFile(file)
            symbols = elf.get_section_by_name(".symtab").iter_symbols()
            self.address = {symbol.name: int(symbol["st_value"]) & ~1 for symbol in symbols}
            loaded = [segment for segment in elf.iter_segments("PT_LOAD") if segment["p_filesz"] > 0]
            self.segments = [(int(part["p_paddr"]), int(part["p_offset"]), part.data()) for part in loaded]

    def word(self, address: int) -> int:
        """A 32-bit word of the flash."""
        start, _, data = next(part for part in self.segments if part[0] <= address < part[0] + len(part[2]))
        return int.from_bytes(data[address - start : address - start + 4], "little")

    def patched(self, path: Path, function: str, instructions: bytes) -> Path:
        """A copy with other instructions at the beginning of a function."""
        address = self.address[function]
        start, offset, _ = next(part for part in self.segments if part[0] <= address < part[0] + len(part[2]))
        content = bytearray(self.path.read_bytes())
        begin = offset + address - start
        content[begin : begin + len(instructions)] = instructions
        path.write_bytes(content)
        return path


def assemble(source: str, folder: Path) -> bytes:
    """Instructions of the Cortex-M4 as bytes."""
    text, object_file, binary = folder / "patch.s", folder / "patch.o", folder / "patch.bin"
    text.write_text(f".syntax unified\n.cpu cortex-m4\n.thumb\n{source}\n")
    subprocess.run(["arm-none-eabi-as", text, "-o", object_file], check=True)
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", object_file, binary], check=True)
    return binary.read_bytes()
