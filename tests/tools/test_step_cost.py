"""omnibot cost as a user calls it: one measurement of the real firmware, and everything it prints and writes."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from step_cost.errors import CostError
from step_cost.measure import Figures

ROOT = Path(__file__).parents[2]
OMNIBOT = ROOT / ".venv" / "bin" / "omnibot"
ORDERS = ("order0", "order1", "order2", "order3", "exact", "observer")


def cost(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([OMNIBOT, "cost", *arguments], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cost")


@pytest.fixture(scope="module")
def result(folder: Path) -> dict[str, Any]:
    done = cost("--json", "--out", folder)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def test_every_order_and_the_tick_are_told(result: dict[str, Any]) -> None:
    assert tuple(result["steps"]) == (*ORDERS, "tick")
    for figures in result["steps"].values():
        assert 0 < figures["instructions_min"] <= figures["instructions_median"] <= figures["instructions_max"]
        assert figures["cycles_min"] <= figures["cycles_median"] <= figures["cycles_max"]
        assert (
            figures["instructions_max"] < figures["cycles_max_low"] < figures["cycles_max"] < figures["cycles_max_high"]
        )
        assert figures["microseconds_max"] == pytest.approx(figures["cycles_max"] / 168.0, abs=1e-3)


def test_each_order_of_the_series_costs_a_round_more_than_the_one_before(result: dict[str, Any]) -> None:
    # Orders 2 and 3 are order 1 with one and two more rounds of the same loop, control.c's corrected_demand.
    instructions = [result["steps"][f"order{order}"]["instructions_min"] for order in (1, 2, 3)]
    first, second = instructions[1] - instructions[0], instructions[2] - instructions[1]
    assert first > 50
    assert second == pytest.approx(first, abs=5)


def test_a_tick_costs_more_than_its_step(result: dict[str, Any]) -> None:
    for order in ORDERS:
        assert result["steps"]["tick"]["by_order"][order]["cycles_max"] > result["steps"][order]["cycles_max"]


def test_ticks_out_of_the_ordinary_are_told_apart(result: dict[str, Any]) -> None:
    kinds = (
        "tick without a step",
        "tick after missed ones",
        "tick with a fault",
        "tick while braking",
        "tick by the timer, own motors",
    )
    assert set(result["other_ticks"]) == set(kinds)
    without, after_missed, _, _, by_timer = (result["other_ticks"][kind] for kind in kinds)
    by_order = result["steps"]["tick"]["by_order"]
    assert without["cycles_max"] < 0.7 * min(by_order[order]["cycles_max"] for order in ORDERS)
    assert after_missed["cycles_max"] > result["steps"]["tick"]["cycles_max"]  # it makes up for the missed ones
    # One closed loop of 250 ms an order; the same step as in lockstep, and fewer frames to decode around it.
    assert by_timer["seen"] == len(ORDERS) * 251
    assert (
        result["steps"]["order0"]["cycles_min"] < by_timer["cycles_max"] < 1.1 * result["steps"]["tick"]["cycles_max"]
    )


def test_stack_of_every_chain_is_no_less_than_what_was_painted(result: dict[str, Any]) -> None:
    assert 200 < result["stack_painted_bytes"] <= result["stack_bytes"]
    assert sum(result["stack_chain"].values()) == result["stack_bytes"]


def test_flash_is_what_size_says(result: dict[str, Any]) -> None:
    image = ROOT / "build" / "target" / result["sizes_of"]
    lines = subprocess.run(
        ["arm-none-eabi-size", image], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    text, data, _ = lines[1].split()[:3]
    assert result["flash_bytes"] == int(text) + int(data)
    modules = sum(parts.get("code", 0) + parts.get("constants", 0) for parts in result["modules"].values())
    assert 0.95 * result["flash_bytes"] < modules <= result["flash_bytes"]


def test_states_have_the_sizes_that_the_compiler_gives(result: dict[str, Any], tmp_path: Path) -> None:
    source = tmp_path / "sizes.c"
    names = list(result["state_bytes"])
    lines = [f"char size_of_{name}[sizeof({name})];" for name in names]
    source.write_text("\n".join(['#include "app.h"', *lines, ""]))
    includes = ["-Ifirmware/app", "-Ifirmware/control", "-Iprotocol", "-Ibuild/target/generated"]
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", *includes, "-c", source, "-o", tmp_path / "sizes.o"]
    subprocess.run(command, check=True, cwd=ROOT)
    listed = subprocess.run(
        ["arm-none-eabi-nm", "-S", tmp_path / "sizes.o"], capture_output=True, text=True, check=True
    )
    sizes = {line.split()[3].removeprefix("size_of_"): int(line.split()[1], 16) for line in listed.stdout.splitlines()}
    assert sizes == result["state_bytes"]


def test_page_needs_nothing_else_and_the_numbers_are_beside_it(result: dict[str, Any], folder: Path) -> None:
    assert json.loads((folder / "cost.json").read_text()) == result
    page = (folder / "report.html").read_text()
    assert '<figure id="cycles"' in page
    assert not re.search(r"https?://|src=", page)
    assert f"omnibot cost --json --out {folder}" in page
    assert str(result["steps"]["order1"]["cycles_max"]) in page


def test_check_fails_on_a_dearer_firmware_and_names_what_grew(
    result: dict[str, Any], folder: Path, tmp_path: Path
) -> None:
    file = tmp_path / "budgets.toml"
    upper = "[must_hold]\n[lenience]\nsame_compiler = 0.01\nother_compiler = 0.01\n\n"
    file.write_text(upper)
    assert cost("--update", "--budgets", file, "--use", folder / "cost.json").returncode == 0
    assert cost("--check", "--budgets", file, "--use", folder / "cost.json").returncode == 0
    # The same budgets without control_step in order 2: the real firmware is dearer than them by just that.
    worst, own = result["steps"]["order2"]["instructions_max"], result["by_function"]["order2"]["control_step"]
    text = file.read_text().replace(f"instructions_max = {worst}\n", f"instructions_max = {worst - own}\n", 1)
    before, heading, after = text.partition("[baseline.order2]\n")
    file.write_text(before + heading + after.replace(f'"control_step" = {own}\n', "", 1))
    done = cost("--check", "--budgets", file, "--use", folder / "cost.json")
    assert done.returncode == 1
    assert f"order2: instructions_max {worst}, budget {worst - own}: {own} over" in done.stderr
    assert f"grew: control_step 0 → {own} (+{own})" in done.stderr


def totals(profile: subprocess.CompletedProcess[str]) -> list[list[str]]:
    """Cells of the rows that add up the tables by kind and by function."""
    assert profile.returncode == 0, profile.stderr
    return [[c.strip() for c in line.split("│")] for line in profile.stdout.splitlines() if line.startswith("│ all")]


def test_profile_adds_up_to_the_worst_step(result: dict[str, Any]) -> None:
    figures = result["steps"]["order0"]
    by_kind, by_function = totals(cost("--profile", "0"))
    assert by_kind[2:4] == by_function[2:4] == [str(figures["instructions_max"]), str(figures["cycles_max"])]


def test_profile_of_the_tick_adds_up_to_the_worst_tick(result: dict[str, Any]) -> None:
    figures = result["steps"]["tick"]["by_order"]["order0"]
    by_kind, by_function = totals(cost("--profile", "0", "--tick"))
    assert by_kind[5:7] == by_function[5:7] == [str(figures["instructions_max"]), str(figures["cycles_max"])]


def test_missing_build_is_one_line_that_says_what_makes_it(tmp_path: Path) -> None:
    done = cost("--build", tmp_path, "--json")
    assert done.returncode == 1
    assert "tools/build target makes it" in done.stderr
    assert json.loads(done.stdout)["status"] == "error"


def test_figures_of_nothing_tell_of_an_image_of_another_build() -> None:
    with pytest.raises(CostError, match="another build than the host's; tools/build host && tools/build target"):
        Figures().range_of("cycles")
