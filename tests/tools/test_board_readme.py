"""The board's page says what its header and the wire say: pins, faults, rates."""

import re
from pathlib import Path

import pytest

from host_sim.codec import Codec
from host_sim.robot import load_robot

PORT = Path(__file__).resolve().parents[2] / "firmware" / "ports" / "stm32f405"
README = (PORT / "README.md").read_text(encoding="utf-8")
HEADER = (PORT / "board_omnibot.h").read_text(encoding="utf-8")


def rows(after: str) -> list[list[str]]:
    """The cells of the table that follows some words."""
    table = README[README.index(after) :].split("\n\n", 2)
    lines = next(part for part in table if part.startswith("|")).splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


PINS = re.findall(r"\{&gpio_(\w), (\d+), GPIO_(\w+), GPIO_\w+, (\d+)\}", HEADER)


def test_header_has_pins() -> None:
    assert len(PINS) == HEADER.count("GPIO_ALTERNATE") + HEADER.count("GPIO_OUTPUT") + HEADER.count("GPIO_ANALOG")


@pytest.mark.parametrize(("port", "pin", "mode", "function"), PINS, ids=[f"P{p.upper()}{n}" for p, n, _, _ in PINS])
def test_pin_of_the_header_is_on_the_page_with_its_function(port: str, pin: str, mode: str, function: str) -> None:
    name = f"P{port.upper()}{pin}"

    (row,) = [cells for cells in rows("<!-- pins -->") if name in re.split(r"[, …]+", cells[0])]

    expected = {"ALTERNATE": f"(AF{function})", "OUTPUT": "output", "ANALOG": "ADC1 IN10"}[mode]
    assert expected in row[1]


def test_no_pin_is_used_twice() -> None:
    names = [(port, pin) for port, pin, _, _ in PINS]
    assert len(set(names)) == len(names)


def test_faults_are_those_of_the_wire() -> None:
    choices = Codec(node=0)["STATUS"].choices["fault"]

    listed = {cells[1]: int(cells[0]) for cells in rows("| n | fault |")}

    assert listed == {name: number for name, number in choices.items() if name != "NONE"}


def test_numbers_of_the_page_are_those_of_the_header_and_the_robot_file() -> None:
    motor = load_robot().motor

    minimum = re.findall(r"BOARD_SUPPLY_MINIMUM_V ([0-9.]+)f", HEADER)
    crystal = re.findall(r"BOARD_CRYSTAL_MHz (\d+)", HEADER)

    assert f"battery below {float(minimum[0]):.1f} V" in README
    assert f"{crystal[0]} MHz; CAN needs it" in README
    assert f"{motor.encoder_counts:.0f} counts a turn of the motor's shaft" in README
    assert f"grows by {motor.encoder_counts * motor.gear_ratio:.0f} in one turn" in README
