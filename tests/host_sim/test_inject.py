"""The real firmware in-process behind a bus that fails: lawful torque, a named end, and a start afterwards."""

import json
import random
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.faults import Fault, FaultPlan, Kind
from host_sim.inject import (
    FAULT_ROWS,
    UNEXPLAINED,
    FaultCase,
    Session,
    Watch,
    fault_cases,
    is_explained,
    restart_cases,
    run_case,
)
from host_sim.planner import PathRequest
from host_sim.robot import load_robot
from host_sim.soak import Memory, SoakResult, soak
from host_sim.sweep import corner_path

CODEC = Codec()
ROBOT = load_robot()
TORQUE_BOUND_NM = 0.2  # firmware/robot/omnibot.toml


def row(name: str, time: str) -> dict[str, Any]:
    [case] = [case for case in fault_cases() if case.name == name and case.time == time]
    return run_case(case)


# ---- the watch: it must notice what must not be


def torque_frame(torque_Nm: float, mode: str) -> can.Message:
    message = CODEC["TORQUE"]
    data = message.pack(0.0, torque_Nm, 0.0, 0, message.choices["mode"][mode])
    return can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=data)


def sync_frame(tick: int) -> can.Message:
    message = CODEC["SYNC"]
    return can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=message.pack(tick, 0, 0))


@pytest.mark.parametrize(
    ("torque_Nm", "mode", "broken"),
    [
        (0.2, "TRACKING", 0),
        (-0.2, "TRACKING", 0),
        (0.20001, "TRACKING", 1),
        (-0.20001, "TRACKING", 1),
        (float("nan"), "TRACKING", 1),
        (0.0, "IDLE", 0),
        (0.00001, "IDLE", 1),
        (-0.00001, "FAULT", 1),
    ],
)
def test_watch_notices_torque_beyond_its_bound_and_outside_tracking(torque_Nm: float, mode: str, broken: int) -> None:
    watch = Watch(CODEC, TORQUE_BOUND_NM)
    watch(False, torque_frame(torque_Nm, mode))
    assert len(watch.violations) == broken


def test_watch_names_no_reason_where_the_bus_shows_none() -> None:
    watch = Watch(CODEC, TORQUE_BOUND_NM)
    watch(True, sync_frame(5))
    watch(False, torque_frame(0.1, "TRACKING"))
    watch(True, sync_frame(6))
    watch(False, torque_frame(0.0, "IDLE"))
    assert watch.left_because == UNEXPLAINED


def test_fault_whose_status_found_no_room_is_named_by_a_later_one() -> None:
    # A burst of 500 ticks makes a thousand answers for an outbox of 16; the one that names the fault is not among them.
    pause = Fault(Kind.PAUSE, first_tick=1154, ticks=500)
    babble = Fault(Kind.FLOOD, first_tick=454, ticks=1, rate=0.8)
    with Session("lockstep") as session:
        outcome = session.drive(PathRequest("line", 0.2), FaultPlan((babble, pause), 3080302222))
    assert outcome.end.startswith(("fault ", "completed")), outcome
    assert outcome.dropped > 100


# ---- the table


@pytest.mark.parametrize("case", list(fault_cases()), ids=lambda case: f"{case.time}: {case.name}")
def test_every_scenario_ends_with_a_reason_lawful_torque_and_a_robot_that_starts_again(case: FaultCase) -> None:
    result = run_case(case)
    assert result["end"] not in (UNEXPLAINED, "diverged"), result
    assert result["violations"] == 0
    assert 0.0 < result["max_torque_Nm"] <= TORQUE_BOUND_NM + 5e-6
    assert result["drives_again"]


def test_no_fault_no_reaction() -> None:
    for time in ("lockstep", "realtime"):
        result = row("nothing", time)
        assert (result["end"], result["wheels_ticks"], result["hits"]) == ("completed", None, 0)


@pytest.mark.parametrize(
    ("name", "time", "end", "firmware_ticks"),
    [
        # The time limits of firmware/robot/omnibot.toml: a reading may be 5 ms, a pose 500 ms old; 10 ticks may lack.
        ("50 ms without wheel speeds", "lockstep", "fault STALE_WHEEL_SPEED", 5),
        ("50 ms without wheel speeds", "realtime", "fault STALE_WHEEL_SPEED", 5),
        ("600 ms without poses", "realtime", "fault STALE_POSE", 500),
        ("50 ms without poses", "realtime", "completed", None),
        ("5 ms without anything", "lockstep", "completed", None),
        ("50 ms without SYNC", "lockstep", "fault TICK_GAP", 50),  # without a clock it sees the gap at its end
        ("50 ms without SYNC", "realtime", "fault STALE_WHEEL_SPEED", 5),  # nobody vouches for them
        ("robot restarted within 1 ms", "lockstep", "restarted", 0),
        ("STOP", "lockstep", "STOP", 0),
    ],
)
def test_reaction_is_the_fault_and_the_time_of_the_design(
    name: str, time: str, end: str, firmware_ticks: int | None
) -> None:
    result = row(name, time)
    assert result["end"] == end
    if firmware_ticks is None:
        assert result["firmware_ticks"] is None
    else:
        # The reading before the gap is one tick old already at its first tick.
        assert abs(result["firmware_ticks"] - firmware_ticks) <= 1


def test_distance_to_the_stop_is_speed_times_time_and_the_way_of_braking() -> None:
    result = row("600 ms without poses", "lockstep")
    # From the corner on, where the path is slower: it lies between the speeds there.
    braking_m = 0.5**2 / (2.0 * ROBOT.parameter("braking_m_per_s2").default)
    assert 0.3 * 0.5 < result["distance_m"] <= 0.5 * 0.501 + 1.01 * braking_m
    assert result["speed_left_m_per_s"] < 1e-3


def test_stop_takes_the_way_of_braking() -> None:
    result = row("STOP", "realtime")
    assert 0.3**2 / 3.0 < result["distance_m"] < 0.5**2 / 3.0 + 0.03  # at 1.5 m/s2, out of a bend of the corner
    assert result["speed_left_m_per_s"] < 1e-3


def test_same_seed_gives_the_same_row_and_another_seed_another() -> None:
    rows = [run_case(FaultCase(*FAULT_ROWS[1], seed)) for seed in (1, 1, 2)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_is_explained_refuses_each_broken_rule() -> None:
    good = {"end": "completed", "violations": 0, "drives_again": True}
    assert is_explained(good)
    for broken in ({"end": UNEXPLAINED}, {"violations": 1}, {"drives_again": False}):
        assert not is_explained({**good, **broken})


# ---- restarts, and the long run


def test_robot_killed_or_paused_at_100_random_ticks_stops_lawfully_and_drives_again() -> None:
    chance = random.Random(7)
    short = PathRequest("rhombus", 0.5, "rounded", 2.0, 1.0, 0.5)
    for number in range(100):
        kind = chance.choice((Kind.RESTART, Kind.PAUSE))
        fault = Fault(kind, first_tick=chance.randrange(1000), ticks=chance.choice((1, 2, 5, 20, 100)))
        with Session(chance.choice(("lockstep", "realtime"))) as session:
            outcome = session.drive(short, FaultPlan((fault,), number))
            assert outcome.violations == [], fault
            assert outcome.end in ("restarted", "completed") or outcome.end.startswith("fault "), (fault, outcome)
            assert (kind is Kind.RESTART) == (outcome.end == "restarted"), (fault, outcome)
            assert session.drives_again(corner_path(0.5)), fault


def test_restart_cases_are_as_many_as_asked_and_the_same_for_the_same_seed() -> None:
    assert list(restart_cases(20, 1)) == list(restart_cases(20, 1))
    assert len(set(restart_cases(20, 1))) == 20


def test_soak_explains_every_end_and_holds_no_memory() -> None:
    result = SoakResult(seed=5)
    soak(60.0, 600.0, result)
    assert result.problems == []
    assert result.simulated_s >= 60.0
    assert sum(result.ends.values()) == result.drives > 3
    assert result.frames_hit > 100
    # A list of one float a tick would be 50,000 blocks.
    assert result.block_growth < 5_000


def test_memory_sees_what_is_kept() -> None:
    before = Memory.now()
    kept = [str(number) * 2 for number in range(100_000)]
    assert Memory.now().blocks - before.blocks > 0.9 * len(kept)


# ---- the command line


def test_inject_writes_its_table_and_says_how_many(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["inject", "--restarts", "4", "--jobs", "1", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "inject.json").read_text())
    assert len(rows) == 4
    assert len((tmp_path / "inject.md").read_text().splitlines()) == 2 + 4


def test_soak_prints_what_machines_read() -> None:
    result = CliRunner().invoke(app, ["soak", "--duration", "1", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["problems"] == []
