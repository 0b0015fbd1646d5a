"""How structs lie in memory, by the DWARF of an ELF file: for the target, and for the host's libraries alike."""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from elftools.elf.elffile import ELFFile

WRAPPERS = ("DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type")


class Leaf(NamedTuple):
    """One number of a struct."""

    name: str  # with its way there: robot, floor.linear, coefficient[0][3]
    offset: int
    size: int
    pointer: bool


class Layout:
    """A struct by the name of its type."""

    def __init__(self, name: str, size: int, leaves: tuple[Leaf, ...]) -> None:
        self.name = name
        self.size = size
        self.leaves = leaves
        self._by_name = {leaf.name: leaf for leaf in leaves}

    def __getitem__(self, leaf: str) -> Leaf:
        return self._by_name[leaf]

    def offset_of(self, member: str) -> int:
        """Return where a struct inside begins."""
        return min(leaf.offset for leaf in self.leaves if leaf.name.startswith(f"{member}."))

    def numbers(self, memory: bytes) -> dict[str, int]:
        """Return the bits of every number in a struct's bytes."""
        return {
            leaf.name: int.from_bytes(memory[leaf.offset : leaf.offset + leaf.size], "little") for leaf in self.leaves
        }

    def memory(self, numbers: dict[str, int]) -> bytearray:
        """Return a struct's bytes with these bits, zero where there are none."""
        made = bytearray(self.size)
        for name, bits in numbers.items():
            leaf = self._by_name[name]
            made[leaf.offset : leaf.offset + leaf.size] = bits.to_bytes(leaf.size, "little")
        return made


def _plain(die: Any) -> Any:
    """Follow typedefs and qualifiers to the type itself."""
    while die.tag in WRAPPERS:
        die = die.get_DIE_from_attribute("DW_AT_type")
    return die


def _size(die: Any) -> int:
    die = _plain(die)
    if die.tag == "DW_TAG_array_type":
        return _size(die.get_DIE_from_attribute("DW_AT_type")) * _product(_counts(die))
    return int(die.attributes["DW_AT_byte_size"].value)


def _counts(array: Any) -> list[int]:
    """Return an array's dimensions."""
    ranges = [child for child in array.iter_children() if child.tag == "DW_TAG_subrange_type"]
    return [int(child.attributes["DW_AT_upper_bound"].value) + 1 for child in ranges]


def _product(numbers: list[int]) -> int:
    product = 1
    for number in numbers:
        product *= number
    return product


def _leaves(die: Any, name: str, offset: int) -> list[Leaf]:
    die = _plain(die)
    if die.tag == "DW_TAG_structure_type":
        found: list[Leaf] = []
        for member in die.iter_children():
            inner = member.attributes["DW_AT_name"].value.decode()
            at = offset + int(member.attributes["DW_AT_data_member_location"].value)
            found += _leaves(member.get_DIE_from_attribute("DW_AT_type"), f"{name}.{inner}" if name else inner, at)
        return found
    if die.tag == "DW_TAG_array_type":
        return _elements(die.get_DIE_from_attribute("DW_AT_type"), _counts(die), name, offset)
    return [Leaf(name, offset, _size(die), die.tag == "DW_TAG_pointer_type")]


def _elements(element: Any, counts: list[int], name: str, offset: int) -> list[Leaf]:
    if not counts:
        return _leaves(element, name, offset)
    step = _size(element) * _product(counts[1:])
    parts = (_elements(element, counts[1:], f"{name}[{i}]", offset + i * step) for i in range(counts[0]))
    return [leaf for part in parts for leaf in part]


@cache
def layouts(file: Path) -> dict[str, Layout]:
    """Return every named struct of an ELF file with debugging information."""
    found: dict[str, Layout] = {}
    with file.open("rb") as opened:
        for unit in ELFFile(opened).get_dwarf_info().iter_CUs():
            for die in unit.get_top_DIE().iter_children():
                if die.tag != "DW_TAG_typedef" or "DW_AT_type" not in die.attributes:
                    continue
                name, struct = die.attributes["DW_AT_name"].value.decode(), _plain(die)
                if struct.tag == "DW_TAG_structure_type" and name not in found:
                    found[name] = Layout(name, _size(struct), tuple(_leaves(struct, "", 0)))
    return found
