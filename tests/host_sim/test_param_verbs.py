"""``omnibot param``, and what a run does to parameters that somebody had set: what is printed, written and refused."""

import json
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.parameters import Session
from host_sim.robot import ROBOT_FILE, load_robot

SHORT = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "0.4"]
TABLE: list[dict[str, Any]] = tomllib.loads(ROBOT_FILE.read_text())["parameter"]


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else is on these buses to be listened to."""
    monkeypatch.setattr("host_sim.parameters.LISTEN_S", 0.01)


def omnibot(*arguments: str) -> Any:
    outcome = CliRunner().invoke(app, list(arguments))
    if isinstance(outcome.exception, OmnibotError):
        raise outcome.exception
    return outcome


class LastingBus(InprocBus):
    """A robot that goes on when a command has let go of its bus."""

    def shutdown(self) -> None:
        """Leave it as it is."""

    def end(self) -> None:
        super().shutdown()


@pytest.fixture
def lasting(monkeypatch: pytest.MonkeyPatch) -> Iterator[LastingBus]:
    """A robot that every command meets again, on a bus named vcan0."""
    bus = LastingBus(node=0)

    def opened(name: str, *_: object) -> can.BusABC:
        assert name == "vcan0"
        return bus

    for verbs in ("drive", "param"):
        monkeypatch.setattr(f"host_sim.cli.{verbs}.open_bus", opened)
    yield bus
    bus.end()


def held(bus: InprocBus) -> dict[str, float | str]:
    told = Session(Link(bus, Codec()), load_robot()).held
    return {row.parameter.name: row.as_dict()["value"] for row in told}


# ---- the verbs


def test_list_prints_a_line_for_each_parameter_of_the_robot_file() -> None:
    lines = omnibot("param", "list").stdout.splitlines()
    assert lines[0].split() == ["index", "name", "value", "default", "unit", "type", "range"]
    rows = [line.split()[:5] for line in lines[1:-1]]
    for row, entry in zip(rows, TABLE, strict=True):
        default = entry["choices"][entry["default"]] if "choices" in entry else f"{entry['default']:g}"
        assert row == [str(entry["index"]), entry["name"], default, default, entry["unit"]]
    assert lines[-1].startswith("the robot came up with the defaults, for it has no memory")


def test_changes_are_printed_and_in_force_for_the_next_command(lasting: LastingBus) -> None:
    vcan = ("--bus", "vcan0")
    printed = omnibot("param", "set", "position_damping_per_s=30", "order=exact", *vcan).stdout.splitlines()
    assert printed[:2] == ["position_damping_per_s: 23 → 30 1/s", "order: observer → exact"]
    assert "2 of 20 differ" in printed[2]
    assert omnibot("param", "get", "position_damping_per_s", *vcan).stdout == "30\n"
    differing = omnibot("param", "diff", *vcan)
    assert differing.exit_code == 1
    assert [line.split()[:3] for line in differing.stdout.splitlines()[1:]] == [
        ["order", "exact", "observer"],
        ["position_damping_per_s", "30", "23"],
    ]
    assert "order: exact → observer" in omnibot("param", "reset", "order", *vcan).stdout
    omnibot("param", "reset", *vcan)
    same = omnibot("param", "diff", *vcan)
    assert (same.exit_code, same.stdout, same.stderr) == (0, "", "no parameter differs from the defaults\n")
    assert held(lasting)["order"] == "observer"


def test_list_that_was_written_is_what_set_and_diff_read(tmp_path: Path, lasting: LastingBus) -> None:
    vcan, file = ("--bus", "vcan0"), tmp_path / "tuned.toml"
    omnibot("param", "set", "epsilon=0.03", "tick_gap_max=7", *vcan)
    omnibot("param", "list", "--out", str(file), *vcan)
    omnibot("param", "reset", *vcan)
    assert omnibot("param", "diff", str(file), *vcan).exit_code == 1
    omnibot("param", "set", "tick_gap_max=8", "--file", str(file), *vcan)
    assert (held(lasting)["epsilon"], held(lasting)["tick_gap_max"]) == (0.03, 8)


def test_json_has_it_all(lasting: LastingBus) -> None:
    document = json.loads(omnibot("param", "set", "epsilon=0.5", "--json", "--bus", "vcan0").stdout)
    assert document["store"] == {"origin": "NO_MEMORY", "unsaved": 1}
    assert document["parameters"][0]["value"] == 0.5
    differences = json.loads(omnibot("param", "diff", "--json", "--bus", "vcan0").stdout)
    assert differences == [{"name": "epsilon", "value": 0.5, "default": 0.01}]
    assert held(lasting)["epsilon"] == 0.5


@pytest.mark.parametrize("bus", [[], ["--bus", "pil"], ["-i", "omnibot", "-c", "x"]])
@pytest.mark.parametrize("change", [["set", "epsilon=0.1"], ["save"], ["reset"]])
def test_change_that_would_be_gone_with_the_command_is_refused(bus: list[str], change: list[str]) -> None:
    with pytest.raises(OmnibotError, match=r"lives only for this command: name the robot's bus.*omnibot run --set"):
        omnibot("param", *change, *bus)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["get", "dampng"], "did you mean position_damping_per_s or heading_damping_per_s"),
        (["set"], "give NAME=VALUE, or --file FILE"),
        (["set", "epsilon"], "omnibot param set epsilon: must be NAME=VALUE"),
        (["diff", "nowhere.toml"], r"cannot read parameters from nowhere\.toml: No such file"),
        (["list", "--timeout", "0"], "--timeout 0 must be"),
        (["list", "--bus", "nowhere0"], "no bus 'nowhere0'"),
        (["list", "--node", "16"], "node 16: must be 0 … 15"),
    ],
)
def test_mistake_says_what_would_be_right(arguments: list[str], says: str) -> None:
    with pytest.raises(OmnibotError, match=says):
        omnibot("param", *arguments)


def test_environment_names_the_bus_for_every_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIBOT_BUS", "nowhere0")
    for verb in (["param", "list"], ["run", *SHORT]):
        with pytest.raises(OmnibotError, match="no bus 'nowhere0'"):
            omnibot(*verb)


# ---- a run, and what the robot held before it


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., tuple[dict[str, Any], list[str]]]:
    """Run; returns result.json and the lines on stderr."""

    def run(*options: str) -> tuple[dict[str, Any], list[str]]:
        outcome = omnibot("run", *SHORT, "--out", str(tmp_path), *options)
        return json.loads((tmp_path / "result.json").read_text()), outcome.stderr.splitlines()

    return run


def test_fresh_robot_leaves_nothing_to_say(run: Callable[..., tuple[dict[str, Any], list[str]]]) -> None:
    result, lines = run("--order", "1", "--set", "position_damping_per_s=30")
    assert lines == []
    assert (result["overridden_parameters"], result["cleared_faults"]) == ({}, [])
    defaults = {e["name"]: e["choices"][e["default"]] if "choices" in e else e["default"] for e in TABLE}
    assert result["parameters"] == defaults | {"order": "1", "position_damping_per_s": 30.0}


def test_run_says_which_parameters_of_the_robot_it_set_anew(
    lasting: LastingBus, run: Callable[..., tuple[dict[str, Any], list[str]]]
) -> None:
    omnibot("param", "set", "position_damping_per_s=30", "order=1", "speed_length_m=2", "--bus", "vcan0")
    result, lines = run("--bus", "vcan0", "--speed-length-m", "0.5")
    assert result["overridden_parameters"] == {
        "order": {"held": "1", "run": "observer"},
        "speed_length_m": {"held": 2.0, "run": 0.5},
        "position_damping_per_s": {"held": 30.0, "run": 23.0},
    }
    assert lines == [
        "omnibot: the robot held other parameters than this run, and now holds the run's: order 1 → observer, "
        "position_damping_per_s 30 → 23; to drive with its own: --order 1 --keep-parameters"
    ]
    assert held(lasting)["position_damping_per_s"] == 23.0


def test_run_drives_with_what_the_robot_holds_where_that_is_asked_for(
    lasting: LastingBus, run: Callable[..., tuple[dict[str, Any], list[str]]]
) -> None:
    omnibot("param", "set", "position_damping_per_s=30", "braking_m_per_s2=1.1", "--bus", "vcan0")
    result, lines = run("--bus", "vcan0", "--keep-parameters", "--set", "braking_m_per_s2=1.2")
    assert lines == []
    assert result["parameters"]["position_damping_per_s"] == 30.0
    assert result["parameters"]["braking_m_per_s2"] == 1.2
    assert held(lasting)["position_damping_per_s"] == 30.0


def test_options_win_over_a_file_of_parameters(
    tmp_path: Path, run: Callable[..., tuple[dict[str, Any], list[str]]]
) -> None:
    file = tmp_path / "tuned.toml"
    file.write_text("order = '2'\noutput = 'point'\nposition_damping_per_s = 30\nbraking_m_per_s2 = 1\n")
    result, _ = run("--set-file", str(file), "--order", "1", "--set", "braking_m_per_s2=2")
    told = result["parameters"]
    assert (told["order"], told["output"]) == ("1", "point")
    assert (told["position_damping_per_s"], told["braking_m_per_s2"]) == (30.0, 2.0)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("position_dampng_per_s=20", "no parameter 'position_dampng_per_s'; did you mean position_damping_per_s"),
        ("torque_bound_Nm=1", r"torque_bound_Nm = 1 is outside 0 … 0.327 N\*m"),
        ("tick_gap_max=1.5", "tick_gap_max = 1.5 must be a whole number"),
        ("order=4", "no order '4'; there are: 0, 1, 2, 3, exact, observer"),
        ("epsilon=soft", "epsilon = soft must be a number, 0 … 1 1/N"),
    ],
)
def test_bad_set_of_a_run_says_what_would_be_right(
    setting: str, says: str, run: Callable[..., tuple[dict[str, Any], list[str]]]
) -> None:
    with pytest.raises(OmnibotError, match=says):
        run("--set", setting)
