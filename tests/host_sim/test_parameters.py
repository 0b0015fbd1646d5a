"""What a robot tells of its parameters over the bus, and changes to them: against the robot file, read on its own."""

import json
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link, RefusedError, SilentError
from host_sim.parameter_file import read_values, write_values
from host_sim.parameters import Session
from host_sim.robot import ROBOT_FILE, ROOT, load_robot
from host_sim.trajectory import Polyline, Segment, Trajectory

NODE = 4
CODEC = Codec(node=NODE)
ROBOT = load_robot()
TABLE: list[dict[str, Any]] = tomllib.loads(ROBOT_FILE.read_text())["parameter"]


class LossyBus(InprocBus):
    """Loses every third answer of the robot about its parameters."""

    def __init__(self) -> None:
        super().__init__(node=NODE)
        self.lose = False
        self._asked = 0

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message, filtered = super()._recv_internal(timeout)
        if self.lose and message is not None and message.arbitration_id in (0x220 | NODE, 0x230 | NODE):
            self._asked += 1
            if self._asked % 3 == 0:
                return None, False
        return message, filtered


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else is on this bus to be listened to."""
    monkeypatch.setattr("host_sim.parameters.LISTEN_S", 0.01)


@pytest.fixture
def bus() -> Iterator[LossyBus]:
    with LossyBus() as bus:
        yield bus


@pytest.fixture
def link(bus: LossyBus) -> Link:
    return Link(bus, CODEC, timeout_s=0.5, repeat_s=0.01)


def values_of(session: Session) -> dict[str, float]:
    return {parameter.name: value for parameter, value in session.held}


# ---- what it tells


def test_robot_tells_the_table_of_the_robot_file(link: Link) -> None:
    told = [held.as_dict() for held in Session(link, ROBOT).held]
    assert len(told) == len(TABLE)
    for row, entry in zip(told, TABLE, strict=True):
        default = entry["choices"][entry["default"]] if "choices" in entry else entry["default"]
        assert row == {
            "index": entry["index"],
            "name": entry["name"],
            "value": default,
            "default": default,
            "minimum": entry["minimum"],
            "maximum": entry["maximum"],
            "unit": entry["unit"],
            "type": entry["type"],
            "choices": entry.get("choices", []),
        }


def test_answers_that_are_lost_are_asked_for_again(bus: LossyBus, link: Link) -> None:
    whole = Session(link, ROBOT).held
    bus.lose = True
    assert Session(link, ROBOT).held == whole


def test_robot_that_does_not_answer_is_named(link: Link) -> None:
    with pytest.raises(SilentError, match="from node 5"):
        Session(Link(link.bus, Codec(node=5), timeout_s=0.05), ROBOT)


# ---- changes


def test_set_values_are_in_force_and_the_others_stay(link: Link) -> None:
    session = Session(link, ROBOT)
    before = values_of(session)
    changes = session.change({"position_damping_per_s": "30", "order": "exact"})
    assert [(change.parameter.name, change.before, change.after) for change in changes] == [
        ("position_damping_per_s", 23.0, 30.0),
        ("order", 5.0, 4.0),
    ]
    assert session.store is not None
    assert session.store.unsaved == 2
    assert values_of(Session(link, ROBOT)) == before | {"position_damping_per_s": 30.0, "order": 4.0}


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ({"torque_bound_Nm": "0.328"}, r"torque_bound_Nm = 0.328: OUT_OF_RANGE; it takes 0 … 0.327 N\*m"),
        ({"epsilon": "nan"}, "OUT_OF_RANGE; it takes 0 … 1 1/N"),
        ({"epsilon": "1e300"}, "epsilon = inf: OUT_OF_RANGE"),
        ({"tick_gap_max": "2.5"}, "OUT_OF_RANGE; it takes 0 … 100, whole numbers only"),
        ({"order": "4"}, "no order '4'; there are: 0, 1, 2, 3, exact, observer"),
        ({"epsilon": "soft"}, "epsilon = soft must be a number, 0 … 1 1/N"),
        ({"position_dampng_per_s": "20"}, r"no parameter 'position_dampng_per_s'; did you mean position_damping_per_s"),
        ({"damping": "20"}, "did you mean position_damping_per_s or heading_damping_per_s"),
        ({"dampng": "20"}, "did you mean position_damping_per_s or heading_damping_per_s"),
        ({"K2": "20"}, r"no parameter 'K2'; did you mean position_damping_per_s or heading_damping_per_s\?"),
        ({"colour": "20"}, "no parameter 'colour'; there are: order, epsilon"),
    ],
)
def test_bad_value_says_what_would_be_right_and_changes_nothing(link: Link, setting: dict[str, str], says: str) -> None:
    session = Session(link, ROBOT)
    session.change({"speed_length_m": "2"})
    with pytest.raises(OmnibotError, match=says):
        session.change({"braking_m_per_s2": "3", "speed_length_m": "0.5"} | setting)
    defaults = {entry["name"]: pytest.approx(entry["default"], rel=1e-7) for entry in TABLE}
    assert values_of(Session(link, ROBOT)) == defaults | {"speed_length_m": 2.0}


def test_reset_of_some_names_leaves_the_others(link: Link) -> None:
    session = Session(link, ROBOT)
    session.change({"speed_length_m": "2", "braking_m_per_s2": "3"})
    session.reset(["speed_length_m"])
    assert values_of(session)["speed_length_m"] == 1.0
    assert values_of(session)["braking_m_per_s2"] == 3.0
    session.reset([])
    assert session.differences(None) == []


def test_save_without_a_memory_says_what_has_one(link: Link) -> None:
    with pytest.raises(RefusedError, match=r"UNABLE.*omnibot-sil --parameters FILE"):
        Session(link, ROBOT).save()


# ---- a robot that drives for another host


def driven_by_another_host(bus: LossyBus) -> Callable[[], int]:
    """Start a drive of another host; returns what drives it one tick on and tells how many it has driven."""
    other = Link(bus, CODEC, timeout_s=0.5)
    other.hello()
    standing = Trajectory([Segment(1_000_000, np.zeros((3, 8)))], Polyline(np.zeros((2, 2))))
    other.upload(standing.to_bytes())
    other.start()
    ticks = iter(range(100))

    def tick() -> int:
        number = next(ticks)
        assert other.tick(number, (0.0, -0.12, 0.0), (0.0, 0.0, 0.0)).mode == "TRACKING"
        return number

    return tick


class Overhearing(Link):
    """A link on a bus on which another host's TORQUE frames go by."""

    def __init__(self, bus: LossyBus, mode: str) -> None:
        super().__init__(bus, CODEC, timeout_s=0.5, repeat_s=0.01)
        self._overheard = [("TORQUE", {"mode": float(CODEC["TORQUE"].choices["mode"][mode])})]

    def hear(self, wait_s: float) -> tuple[str, dict[str, float]] | None:
        return self._overheard.pop() if self._overheard else super().hear(wait_s)


def test_robot_that_drives_is_read_and_not_disturbed(bus: LossyBus) -> None:
    tick = driven_by_another_host(bus)
    tick()
    session = Session(Overhearing(bus, "TRACKING"), ROBOT)
    assert session.moving == "TRACKING"
    assert len(session.held) == len(TABLE)
    for change in (lambda: session.change({"epsilon": "0.1"}), session.save, lambda: session.reset([])):
        with pytest.raises(RefusedError, match="node 4 is TRACKING for another host"):
            change()
    assert tick() == 1  # its host's session goes on


# ---- files


@pytest.mark.parametrize("name", ["kept.toml", "kept.json"])
def test_file_holds_what_was_in_force(tmp_path: Path, link: Link, name: str) -> None:
    session = Session(link, ROBOT)
    session.change({"epsilon": "0.03", "order": "exact", "tick_gap_max": "7"})
    write_values(tmp_path / name, session.held)
    session.reset([])
    there = read_values(tmp_path / name)
    changed = {(c.parameter.name, c.parameter.text(c.before)) for c in session.differences(there)}
    assert changed == {("epsilon", "0.03"), ("order", "exact"), ("tick_gap_max", "7")}
    session.change(there)
    assert session.differences(there) == []


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("epsilon = 0.5\norder = 'exact'\n", {"epsilon": "0.5", "order": "exact"}),
        ("[parameters]\nepsilon = 1\n[other]\nx = 1\n", {"epsilon": "1"}),
    ],
)
def test_toml_may_have_a_table_or_none(tmp_path: Path, text: str, values: dict[str, str]) -> None:
    file = tmp_path / "some.toml"
    file.write_text(text)
    assert read_values(file) == values


def test_list_that_was_printed_as_json_is_a_file_of_values(tmp_path: Path) -> None:
    file = tmp_path / "list.json"
    file.write_text(json.dumps({"parameters": [{"name": "epsilon", "value": 0.5, "unit": "1/N"}]}))
    assert read_values(file) == {"epsilon": "0.5"}


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.toml", "epsilon = \n", "cannot read parameters from .*a.toml: "),
        ("a.json", "{", "cannot read parameters from .*a.json: "),
        ("a.toml", "", "a.toml has no parameters"),
        ("a.toml", "epsilon = [1]\n", "a.toml has no parameters"),
        ("a.toml", "epsilon = true\n", "a.toml has no parameters"),
        ("a.json", "[3]", "a.json has no parameters"),
        ("a.json", '{"parameters": [{"nome": 1}]}', "a.json has no parameters"),
    ],
)
def test_file_without_values_is_refused_by_name(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(OmnibotError, match=says):
        read_values(tmp_path / name)


def test_file_that_is_not_there_is_refused_by_name() -> None:
    with pytest.raises(OmnibotError, match=r"nowhere\.toml: No such file"):
        read_values(ROOT / "nowhere.toml")
