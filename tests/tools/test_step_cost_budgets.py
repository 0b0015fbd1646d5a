"""Budgets: what is above one is told with its size and who grew; what --update writes is read again."""

import copy
from pathlib import Path
from typing import Any

import pytest
from step_cost import budgets
from step_cost.errors import CostError

UPPER = """
[must_hold.order1]
cycles_max = 1200

[must_hold.every_step]
worst_over_median = 1.15

[must_hold.firmware]
stack_bytes = 768

[lenience]
same_compiler = 0.01
other_compiler = 0.15

"""


def step(instructions: int, cycles: int, worst_over_median: float = 1.0) -> dict[str, Any]:
    return {"instructions_max": instructions, "cycles_max": cycles, "worst_over_median": worst_over_median}


def a_result() -> dict[str, Any]:
    tick = step(1500, 2000) | {"by_order": {"order0": step(1400, 1900), "order1": step(1500, 2000)}}
    return {
        "compiler": "GNU C11 12.2.1",
        "steps": {"order0": step(600, 900), "order1": step(800, 1100), "tick": tick},
        "by_function": {
            "order0": {"control_step": 600},
            "order1": {"control_step": 600, "tracking_eta": 200},
            "tick": {"control_step": 600, "pose_decode": 900},
        },
        "modules": {"control.c": {"code": 4000, "constants": 100}, "app.c": {"code": 1000}},
        "stack_bytes": 500,
        "stack_chain": {"app_receive": 100, "control_step": 400},
        "flash_bytes": 5100,
        "ram_bytes": 700,
    }


@pytest.fixture
def file(tmp_path: Path) -> Path:
    made = tmp_path / "budgets.toml"
    made.write_text(UPPER)
    budgets.update(a_result(), made)
    return made


def failure(result: dict[str, Any], file: Path) -> list[str]:
    with pytest.raises(budgets.BudgetError) as caught:
        budgets.check(result, file)
    return str(caught.value).split("\n  ")[1:]


def test_figures_of_the_update_are_within_their_budgets(file: Path) -> None:
    # three things with two figures each, and three figures of the firmware
    assert budgets.check(a_result(), file) == "within all 9 budgets and every limit of budgets.toml"


def test_step_above_its_budget_is_told_with_the_functions_that_grew(file: Path) -> None:
    result = a_result()
    result["steps"]["order1"]["instructions_max"] = 840
    result["by_function"]["order1"] = {"control_step": 630, "tracking_eta": 180, "angle_wrap": 30}
    assert failure(result, file) == [
        "order1: instructions_max 840, budget 800: 40 over (5.0 %); "
        "grew: control_step 600 → 630 (+30); angle_wrap 0 → 30 (+30)"
    ]


def test_flash_and_stack_name_modules_and_frames(file: Path) -> None:
    result = a_result()
    result |= {"flash_bytes": 5300, "stack_bytes": 600}
    result["modules"]["app.c"]["code"] = 1200
    result["stack_chain"] = {"app_receive": 100, "control_step": 500}
    assert failure(result, file) == [
        "firmware: stack_bytes 600, budget 500: 100 over (20.0 %); grew: control_step 400 → 500 (+100)",
        "firmware: flash_bytes 5300, budget 5100: 200 over (3.9 %); grew: app.c 1000 → 1200 (+200)",
    ]


def test_what_must_hold_is_not_moved_by_an_update(file: Path) -> None:
    result = a_result()
    result["steps"]["order1"]["cycles_max"] = 1300
    budgets.update(result, file)
    assert failure(result, file) == ["order1: cycles_max 1300, must hold: at most 1200: 100 over (8.3 %)"]


def test_spread_of_any_order_is_held(file: Path) -> None:
    result = a_result()
    result["steps"]["order0"]["worst_over_median"] = 1.2
    result["steps"]["tick"]["worst_over_median"] = 1.9  # over all orders together: of no meaning
    assert failure(result, file) == ["order0: worst_over_median 1.2, must hold: at most 1.15: 0.05 over (4.3 %)"]


@pytest.mark.parametrize(
    ("compiler", "instructions", "good"),
    [
        ("GNU C11 12.2.1", 808, True),
        ("GNU C11 12.2.1", 809, False),
        ("GNU C11 13.2.0", 919, True),
        ("GNU C11 13.2.0", 921, False),
    ],
)
def test_another_compiler_is_given_more_room(file: Path, compiler: str, instructions: int, good: bool) -> None:
    result = a_result() | {"compiler": compiler}
    result["steps"]["order1"]["instructions_max"] = instructions
    if good:
        budgets.check(result, file)
    else:
        assert len(failure(result, file)) == 1


def test_update_keeps_what_people_wrote(file: Path) -> None:
    before = file.read_text()
    budgets.update(copy.deepcopy(a_result()), file)
    assert file.read_text() == before
    assert before.startswith(UPPER)


def test_file_without_budgets_says_how_to_get_them(tmp_path: Path) -> None:
    file = tmp_path / "budgets.toml"
    file.write_text(UPPER)
    with pytest.raises(CostError, match="holds no budgets yet: omnibot cost --update writes them"):
        budgets.check(a_result(), file)


def test_missing_and_broken_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(CostError, match=r"cannot read the budgets .*none\.toml"):
        budgets.check(a_result(), tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[must_hold")
    with pytest.raises(CostError, match=r"cannot read the budgets .*broken\.toml"):
        budgets.check(a_result(), broken)
