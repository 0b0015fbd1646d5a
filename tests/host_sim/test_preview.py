"""The preview of a drive: its numbers against the drive itself, and every command that the READMEs say about it."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.errors import OmnibotError
from host_sim.planner import PathRequest
from host_sim.preview import Preview
from host_sim.robot import ROOT, load_robot
from host_sim.trace import Trace

SLALOM = str(ROOT / "host_sim" / "examples" / "slalom.csv")


def omnibot(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def documented_commands() -> list[str]:
    """Commands of the READMEs that plan, or that drive a path planned by limits."""
    text = "".join((ROOT / name).read_text("utf-8") for name in ("README.md", "host_sim/README.md"))
    commands = re.findall(r"^    \.venv/bin/omnibot ((?:plan|run) .*?)(?:\s+#.*)?$", text, re.MULTILINE)
    return [c for c in commands if c.startswith("plan ") or "examples/" in c or "--profile" in c]


def test_readmes_have_commands() -> None:
    commands = documented_commands()
    assert sum(command.startswith("plan ") for command in commands) >= 4
    assert any(command.startswith("run ") for command in commands)


@pytest.mark.parametrize("command", documented_commands())
def test_command_of_the_readmes_works(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    omnibot(*shlex.split(command), "--out", str(tmp_path))
    assert (tmp_path / "report.html").exists()


def test_preview_tells_what_the_drive_then_takes(tmp_path: Path) -> None:
    # The plant knows nothing of the preview: its wheels slip, and their torque is the controller's.
    plan = json.loads(omnibot("plan", "--path", SLALOM, "--speed", "0.8", "--json", "--out", str(tmp_path / "plan")))
    run = json.loads(omnibot("run", "--path", SLALOM, "--speed", "0.8", "--json", "--out", str(tmp_path / "run")))
    assert run["status"] == "completed"
    assert run["tracking"]["max_error_m"] < 2e-4
    trace = Trace.load(tmp_path / "run")
    asked = plan["asked"]
    assert np.max(np.abs(trace.torque)) == pytest.approx(asked["wheel_torque_Nm"]["largest"], rel=0.02)
    assert np.max(np.abs(trace.wheel_force)) == pytest.approx(asked["wheel_force_N"]["largest"], rel=0.02)
    slip = run["slip"]["max_ratio"]
    assert np.max(np.abs(trace.wheel_speed)) == pytest.approx(asked["wheel_speed_rad_per_s"]["largest"], rel=slip)
    assert trace.time_s[-1] == pytest.approx(plan["duration_s"], abs=2e-3)
    assert plan == json.loads((tmp_path / "plan" / "plan.json").read_text())


def test_numbers_of_a_circle_are_those_of_circular_motion() -> None:
    numbers = Preview(PathRequest("circle", 1.0), load_robot()).numbers()
    assert (numbers["path"], numbers["profile"]) == ("circle", "steady")
    # A lap of the circle, and half of each ramp besides.
    assert numbers["length_m"] == pytest.approx(2.0 * np.pi, rel=1e-3)
    asked = numbers["asked"]
    assert asked["speed_m_per_s"] == asked["speed_m_per_s"] | {"limit": None, "share": None}
    assert asked["speed_m_per_s"]["largest"] == pytest.approx(1.0, rel=1e-4)
    assert asked["wheel_speed_rad_per_s"]["largest"] == pytest.approx(1.0 / 0.0349, rel=1e-3)
    assert asked["wheel_speed_rad_per_s"]["share"] == pytest.approx(0.0115 * 20.0 / 12.0 / 0.0349, rel=1e-3)


def test_text_has_a_row_for_each_quantity_and_where() -> None:
    text = Preview(PathRequest("square", 0.5), load_robot()).text()
    assert text.startswith("square, fastest: 7.8")
    rows = [line for line in text.splitlines() if line.startswith("| ")][2:]
    assert [row.split("|")[1].strip() for row in rows] == [
        "speed",
        "acceleration",
        "jerk",
        "wheel speed",
        "wheel force",
        "wheel torque",
    ]
    assert all(row.count("|") == 9 for row in rows)
    assert re.search(r"\| acceleration \| (2|1\.99\d) m/s\^2 \| 2 m/s\^2 \| (100\.0|99\.\d) % \|", text)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--limit", "accel=2"], "--limit accel: there is no such limit; there are: accel_m_per_s2, jerk_m_per_s3"),
        (["--limit", "accel_m_per_s2"], "must be NAME=VALUE"),
        (["--limit", "accel_m_per_s2=-1"], "limit accel_m_per_s2 = -1 must be a number from 1e-06"),
        (["--profile", "fast"], "unknown profile 'fast'; there are: steady, fastest"),
        (["--path", "spiral"], "unknown path 'spiral'"),
        (["--path", "nowhere.csv"], "cannot read nowhere.csv: No such file"),
        (["--speed", "0.5", "--limit", "wheel_speed_rad_per_s=10"], "wheel speed 13.84 rad/s is above the limit of 10"),
    ],
)
def test_mistake_is_told(arguments: list[str], says: str) -> None:
    with pytest.raises(OmnibotError) as error:
        omnibot("plan", *arguments)
    assert says in str(error.value)
