"""tools/generate_constants.py: the hash by which kept parameters are told from those of another table."""

import importlib.util
from dataclasses import replace
from types import ModuleType

import pytest

from host_sim.robot import ROOT, Parameter, load_robot


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate_constants", ROOT / "tools" / "generate_constants.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table() -> tuple[Parameter, ...]:
    return load_robot(ROOT / "firmware" / "robot" / "omnibot.toml").parameters


def test_table_hash_changes_with_whatever_gives_a_value_its_meaning(
    tool: ModuleType, table: tuple[Parameter, ...]
) -> None:
    first, *rest = table
    others = [
        replace(first, index=first.index + 1),
        replace(first, name="another"),
        replace(first, unit="mm"),
        replace(first, integer=not first.integer),
        replace(first, minimum=first.minimum - 1.0),
        replace(first, maximum=first.maximum + 1.0),
    ]
    tables = [table, *((other, *rest) for other in others), table[:-1], table[::-1]]
    hashes = {tool.table_hash(each) for each in tables}
    assert len(hashes) == len(tables)


def test_table_hash_stays_with_another_default_or_source(tool: ModuleType, table: tuple[Parameter, ...]) -> None:
    other = tuple(replace(p, default=p.maximum, source="another") for p in table)
    assert tool.table_hash(other) == tool.table_hash(table)


def test_header_carries_the_hash(tool: ModuleType, table: tuple[Parameter, ...]) -> None:
    assert f"#define PARAMETER_TABLE_HASH 0x{tool.table_hash(table):08X}u " in tool.table_header(table)
