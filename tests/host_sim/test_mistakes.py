"""Ten mistakes of a newcomer: each ends in one line that says what helps. tests/sil has those that need a vcan.

1 wrong interface        6 a CSV of waypoints that cannot be read
2 no vcan                7 too fast a path
3 wrong node             8 bad parameter (and what there is, and its range)
4 firmware not built     9 board not connected
5 old DBC               10 second run on the same bus: tests/sil/test_sil.py, tests/host_sim/test_link.py
"""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from host_sim.cli import main
from host_sim.link import is_can_interface
from host_sim.robot import ROOT

NO_INTERFACE = "novcan7"
Told = Callable[..., str]


def only_line(status: object, stdout: str, stderr: str) -> str:
    """Return the one line that a mistake ends in."""
    assert status == 1
    assert stdout == ""
    assert stderr.startswith("omnibot: ")
    assert stderr.count("\n") == 1
    return stderr


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Told:
    """Give the command to this process, and return the line that it ends in."""

    def line_of(*arguments: str | Path) -> str:
        monkeypatch.setattr(sys, "argv", ["omnibot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return only_line(ended.value.code, *capfd.readouterr())

    return line_of


@pytest.mark.parametrize(
    ("mistake", "what", "helps"),
    [
        # 1: wrong interface
        (["--bus", "lo"], "no bus 'lo'", "or a SocketCAN interface that is up"),
        (["-i", "sockcan", "-c", "vcan0"], 'Unknown interface type "sockcan"', "there are: canalystii, "),
        # 2: no vcan
        (["--bus", NO_INTERFACE], f"no bus '{NO_INTERFACE}'", "tools/with-vcan -- COMMAND makes a vcan0"),
        (["-i", "socketcan", "-c", NO_INTERFACE], NO_INTERFACE, "omnibot doctor tells what is there"),
        # 3: wrong node
        (["--node", "16"], "node 16", "must be 0 … 15"),
        (["-i", "virtual", "-c", "x", "--node", "5", "--timeout", "0.3"], "from node 5", "--node 5"),
        # 7: too fast a path
        (["--speed", "3"], "speed_m_per_s = 3 is too high", "at most 2.045 m/s"),
        # 8: bad parameter
        (["--set", "gain=3"], "no parameter 'gain'", "there are: order, epsilon, "),
        (["--set", "epsilon=7"], "epsilon = 7 is outside", "0 … 1 1/N"),
        (["--set", "order=4"], "no order '4'", "there are: 0, 1, 2, 3, exact, observer"),
        (["--set", "epsilon"], "--set epsilon", "must be NAME=VALUE"),
        # 9: board not connected
        (["-i", "slcan", "-c", "/dev/ttyACM77"], "cannot open /dev/ttyACM77", "is the board plugged in? Serial ports"),
        (["-i", "slcan"], "slcan needs a port", "--channel /dev/ttyACM0"),
    ],
)
def test_mistake_on_the_command_line_is_told_with_what_helps(
    told: Told, tmp_path: Path, mistake: list[str], what: str, helps: str
) -> None:
    assert not is_can_interface(NO_INTERFACE)
    line = told("run", *mistake, "--out", tmp_path / "out")
    assert what in line
    assert helps in line


# ---- 4: firmware not built


def test_firmware_that_is_not_built_names_the_command_that_builds_it(tmp_path: Path) -> None:
    """A clone of the sources as far as a run reads them, without a build folder."""
    shutil.copytree(ROOT / "host_sim", tmp_path / "host_sim", ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("firmware/robot/omnibot.toml", "protocol/omnibot.dbc", "pyproject.toml"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    command = [sys.executable, "-c", "from host_sim.cli import main; main()", "run"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path)
    line = only_line(ended.returncode, ended.stdout, ended.stderr)
    assert f"{tmp_path}/build/host/libomnibot.so" in line
    assert "tools/build host makes it" in line
    assert not (tmp_path / "runs").exists()


def test_python_package_that_is_missing_names_the_command_that_brings_it() -> None:
    program = "import sys; sys.modules['numba'] = None; from host_sim.cli import main; main()"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert "no Python package numba: tools/setup run" in only_line(ended.returncode, ended.stdout, ended.stderr)


# ---- 5: old DBC


def test_old_dbc_names_both_protocols_and_the_cure(told: Told, tmp_path: Path) -> None:
    old = tmp_path / "old.dbc"
    old.write_text((ROOT / "protocol" / "omnibot.dbc").read_text() + '\nCM_ "of last year";\n')
    line = told("run", "--dbc", old, "--out", tmp_path / "out")
    assert "speaks protocol" in line
    assert "rebuild the firmware from this protocol/omnibot.dbc (tools/build host)" in line


# ---- 6: a CSV of waypoints that cannot be read


@pytest.mark.parametrize(
    ("content", "what", "helps"),
    [
        (None, "No such file", "cannot read"),
        ("", "is empty", "it must have a header line and waypoints (x1_m,x2_m"),
        ("x,y\n0,0\n1,0\n", "line 1: no column 'x' is known", "there are: x1_m, x2_m"),
        ("x1_m,x2_m\n0,0\n1,zero\n", "line 3: x2_m", "must be a number"),
        ("x1_m,x2_m\n0,0\n1\n", "line 3 has 1 cells", "it must have 2: x1_m, x2_m"),
        ("x1_m,x2_m\n0,0\n", "1 waypoints", "there must be 2 to"),
    ],
)
def test_bad_csv_names_the_place_and_what_would_be_right(
    told: Told, tmp_path: Path, content: str | None, what: str, helps: str
) -> None:
    file = tmp_path / "path.csv"
    if content is not None:
        file.write_text(content)
    line = told("run", "--path", file, "--out", tmp_path / "out")
    assert str(file) in line
    assert what in line
    assert helps in line


# ---- 7: too fast a path


def test_timed_waypoints_that_are_too_fast_name_the_limit_that_breaks_and_where(told: Told, tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("x1_m,x2_m,time_s\n0,0,0\n1,0,0.2\n2,1,0.4\n3,1,0.6\n")
    line = told("run", "--path", file, "--out", tmp_path / "out")
    assert f"{file} is too much: wheel force" in line
    assert "is above the limit of 3.5 N at 0.063 m along the path" in line
    assert "give it more time there" in line


# ---- 9: board not connected


def test_flashing_without_a_tool_names_the_package(told: Told, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    line = told("flash")
    assert "apt-get install openocd" in line
