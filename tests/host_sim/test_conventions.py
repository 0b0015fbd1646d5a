"""What holds for every verb: JSON, exit codes, Ctrl-C, colours, completion."""

import itertools
import json
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from host_sim.cli import app, main
from host_sim.doctor import CHECKS
from host_sim.paper.write import ITEMS
from host_sim.robot import ROOT, load_robot
from host_sim.sweep import SWEEPS, odometry_cases
from host_sim.trace import Trace

SHORT = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "0.6"]
COMMAND = [sys.executable, "-c", "from host_sim.cli import main; main()"]


class Ended(NamedTuple):
    code: object
    stdout: str
    stderr: str


Omnibot = Callable[..., Ended]


@pytest.fixture
def omnibot(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Omnibot:
    """Give the command to this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def end_of(*arguments: str | Path) -> Ended:
        monkeypatch.setattr(sys, "argv", ["omnibot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return Ended(ended.value.code, *capfd.readouterr())

    return end_of


def verbs(group: Any, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name, command in group.commands.items():
        yield from verbs(command, (*before, name)) if hasattr(command, "commands") else [(*before, name)]


# ---- JSON

# A short call of every verb, and its exit code; {run} is the folder of a run, {image} a board's image.
EXAMPLES: dict[tuple[str, ...], tuple[list[str], int]] = {
    ("run",): (SHORT, 0),
    ("plan",): (["--path", "circle"], 0),
    ("compare",): (["{run}", "{run}"], 0),
    ("monitor",): (["-i", "virtual", "-c", "nobody", "--for", "0.1"], 1),
    ("step",): (["--duration", "0.5"], 0),
    ("param", "list"): ([], 0),
    ("param", "get"): (["epsilon"], 0),
    ("param", "set"): (["epsilon=0.02"], 0),
    ("param", "save"): ([], 1),  # in-process there is no memory to keep them in
    ("param", "reset"): ([], 0),
    ("param", "diff"): ([], 0),
    ("log", "record"): (["bus.log", "-i", "virtual", "-c", "nobody", "--duration", "0.1"], 0),
    ("log", "export"): (["{run}", "--out", "signals.npz"], 0),
    ("replay",): (["{run}"], 0),
    ("paper",): (["--only", "fig2"], 0),
    ("sweep",): (["tiny", "--jobs", "1"], 0),
    ("inject",): (["--restarts", "1", "--jobs", "1"], 0),
    ("soak",): (["--duration", "1"], 0),
    ("cost",): (["--use", "nothing.json"], 1),  # tests/tools/test_step_cost.py has the whole one
    ("bench",): (["--only", "vcan", "--bus", "novcan7"], 0),
    ("busload",): ([], 0),
    ("flash",): (["--dry-run", "--image", "{image}"], 0),
    ("doctor",): ([], 0),
}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    subprocess.run([*COMMAND, "run", *SHORT, "--out", folder], check=True, capture_output=True, timeout=120)
    return folder


@pytest.fixture
def places(run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """See to what the examples need."""
    monkeypatch.setitem(SWEEPS, "tiny", lambda: itertools.islice(odometry_cases(), 2))
    monkeypatch.setattr("host_sim.cli.board.CHECKS", [check for check in CHECKS if check.name == "C compiler"])
    monkeypatch.setattr("host_sim.cli.param._refuse_short_lived", lambda _: None)
    monkeypatch.setattr("host_sim.flash.shutil.which", lambda name: f"/usr/bin/{name}")
    image = tmp_path / "omnibot.bin"
    image.write_bytes(struct.pack("<II", 0x2000_2000, 0x0800_0009) + bytes(100))
    return {"run": run_folder, "image": image}


def test_every_verb_is_in_the_list_of_examples() -> None:
    assert set(verbs(typer.main.get_command(app))) == set(EXAMPLES)


@pytest.mark.parametrize("verb", EXAMPLES, ids=" ".join)
def test_json_is_one_document_and_nothing_else(
    omnibot: Omnibot, places: dict[str, Path], verb: tuple[str, ...]
) -> None:
    arguments, code = EXAMPLES[verb]
    ended = omnibot(*verb, *(argument.format(**places) for argument in arguments), "--json")
    assert ended.code == code, ended.stderr
    assert isinstance(json.loads(ended.stdout), dict | list)
    assert "\x1b" not in ended.stdout + ended.stderr


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["run", "--path", "spiral"], "error"),
        (["run", *SHORT, "--set", "error_limit_m=0.001", "--order", "0", "--epsilon", "0.1"], "diverged"),
    ],
)
def test_json_of_a_failure_is_one_document_too(omnibot: Omnibot, arguments: list[str], status: str) -> None:
    ended = omnibot(*arguments, "--json")
    assert ended.code == 1
    assert json.loads(ended.stdout)["status"] == status


# ---- exit codes


def test_exit_codes_are_as_help_and_readme_say(omnibot: Omnibot) -> None:
    help_text = " ".join(omnibot("--help").stdout.split())
    for words in ("0 done", "1 failed, or refused", "2 not a command of ours", "130 ended by Ctrl-C"):
        assert words in help_text
        assert words in " ".join((ROOT / "README.md").read_text().split())
    assert omnibot("busload").code == 0
    assert omnibot("busload", "--nodes", "16").code == 1  # it does not fit: failed
    assert omnibot("busload", "--nodes", "17").code == 1  # there are no such nodes: refused
    for not_ours in (["fly"], ["busload", "--wings"], ["busload", "--nodes", "many"]):
        assert omnibot(*not_ours).code == 2


# ---- Ctrl-C


def test_interrupted_run_leaves_its_trace_and_a_result(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = subprocess.Popen(
        [*COMMAND, "run", "--pace", "0.5", "--out", folder, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    )
    log = folder / "bus.log"
    while not log.exists() or log.stat().st_size < 10_000:  # dozens of ticks
        assert run.poll() is None
        time.sleep(0.05)
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=120)
    assert run.returncode == 130
    result = json.loads(stdout)
    assert result == json.loads((folder / "result.json").read_text())
    assert result["status"] == "interrupted"
    assert 10 < len(Trace.load(folder)) == result["timing"]["steps"] < 10_000
    assert (folder / "report.html").exists()
    assert stderr.startswith("omnibot: stopped by Ctrl-C at ")
    assert stderr.count("\n") == 1


def rows_then_ctrl_c(*rows: dict[str, object]) -> Iterator[dict[str, object]]:
    yield from rows
    raise KeyboardInterrupt


@pytest.mark.parametrize("name", ["sweep", "inject"])
def test_interrupted_table_keeps_its_rows(omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    rows: list[dict[str, object]] = [{"status": "completed", "end": "completed", "violations": 0, "drives_again": True}]
    for which in ("run_sweep", "run_cases"):
        monkeypatch.setattr(f"host_sim.cli.study.{which}", lambda *_: rows_then_ctrl_c(*rows))
    ended = omnibot(name, *(["odometry"] if name == "sweep" else []), "--out", "table", "--json")
    assert ended.code == 130
    assert json.loads(ended.stdout) == json.loads(Path(f"table/{name}.json").read_text()) == rows
    assert Path(f"table/{name}.md").read_text().count("\n") == 3
    assert "has 1 of " in ended.stderr


def test_interrupted_paper_keeps_what_is_done(omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setitem(ITEMS, "fig4", interrupted)
    ended = omnibot("paper", "--only", "fig2,fig4,table1", "--out", "paper", "--json")
    assert ended.code == 130
    numbers = json.loads(ended.stdout)
    assert numbers == json.loads(Path("paper/paper.json").read_text())
    assert "fig2" in numbers
    assert numbers["missing"] == ["fig4", "table1"]
    assert "is without fig4, table1" in ended.stderr
    assert Path("paper/report.html").exists()


def test_interrupted_soak_tells_what_it_has_seen(omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch) -> None:
    def one_drive(_session: object, _chance: object, result: Any) -> None:
        if result.drives == 3:
            raise KeyboardInterrupt
        result.drives += 1
        result.simulated_s += 5.0

    monkeypatch.setattr("host_sim.soak._one_drive", one_drive)
    ended = omnibot("soak", "--json")
    assert ended.code == 130
    assert json.loads(ended.stdout)["drives"] == 3
    assert ended.stderr == "omnibot: interrupted after 15 s of simulated time\n"


def test_interrupted_flash_says_what_the_board_may_hold(omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("host_sim.cli.board.flash", interrupted)
    ended = omnibot("flash")
    assert ended.code == 130
    assert "flash the board again" in ended.stderr


# ---- colours and progress


def on_a_terminal(*arguments: str | Path, **environment: str) -> str:
    """Run the command with a terminal as its stderr; returns what that shows."""
    ours, theirs = pty.openpty()
    kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR")}
    with subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=theirs, env=kept | {"TERM": "xterm"} | environment
    ):
        os.close(theirs)
        shown = b""
        while True:
            try:
                shown += os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
    os.close(ours)
    return shown.decode()


def test_colours_are_for_terminals_whose_user_wants_them() -> None:
    assert "\x1b[1;31momnibot:" in on_a_terminal("busload", "--nodes", "17")
    assert re.search(r"\x1b\[[0-9;]*3[0-9]m", on_a_terminal("busload", "--nodes", "17", NO_COLOR="1")) is None


def test_progress_on_a_terminal_shows_the_time_left(tmp_path: Path) -> None:
    shown = on_a_terminal("run", *SHORT, "--pace", "0.6", "--out", tmp_path / "run")
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown)
    assert re.search(r"drive [━╸╺ ]+ [1-9][0-9]?% [0-9]:[0-9]{2}:[0-9]{2}", plain)


# ---- completion


@pytest.fixture
def complete(omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """Return what bash would offer behind a line."""

    def offered(line: str) -> list[str]:
        words = line.split(" ")
        monkeypatch.setenv("_OMNIBOT_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
        return omnibot().stdout.split()

    return offered


@pytest.mark.parametrize(
    ("line", "offers"),
    [
        ("omnibot swe", ["sweep"]),
        ("omnibot run --order ", ["0", "1", "2", "3", "exact", "observer"]),
        ("omnibot run --order ex", ["exact"]),
        ("omnibot run --traction ", ["linear", "magic"]),
        ("omnibot run --path l", ["line", "lemniscate"]),
        ("omnibot run --output ", ["posture", "point"]),
        ("omnibot run --corner ", ["sharp", "rounded"]),
        ("omnibot run --profile ", ["steady", "fastest"]),
        ("omnibot run --time ", ["lockstep", "realtime"]),
        ("omnibot run --bus in", ["inproc"]),
        ("omnibot run -i socketcan", ["socketcan", "socketcand"]),
        ("omnibot run --node 1", ["1", "10", "11", "12", "13", "14", "15"]),
        ("omnibot run --plant mass", [f"mass_kg={load_robot().mass_kg:g}"]),
        ("omnibot plan --limit wheel_f", ["wheel_force_N="]),
        ("omnibot sweep ", ["stability", "robustness", "odometry"]),
        ("omnibot paper --only fig2,fig3", ["fig2,fig3a", "fig2,fig3b"]),
        ("omnibot bench --only ", ["plant", "loop", "vcan"]),
        ("omnibot flash --runner ", ["openocd", "st-flash", "pyocd", "dfu-util"]),
    ],
)
def test_values_are_completed(complete: Callable[[str], list[str]], line: str, offers: list[str]) -> None:
    assert complete(line) == offers


def test_every_parameter_is_completed_with_its_default_or_choices(complete: Callable[[str], list[str]]) -> None:
    offers = complete("omnibot run --set ")
    robot = load_robot()
    assert {offer.partition("=")[0] for offer in offers} == {parameter.name for parameter in robot.parameters}
    for offer in offers:
        name, _, value = offer.partition("=")
        assert robot.parameter(name).parse(value) is not None
    assert [offer for offer in offers if offer.startswith("traction=")] == ["traction=linear", "traction=magic"]


def test_files_of_waypoints_are_completed(complete: Callable[[str], list[str]], tmp_path: Path) -> None:
    for name in ("lap.csv", "lap.toml", "lap.txt", "lap folder.csv", ".lap.csv"):
        (tmp_path / name.replace(" ", "-")).touch()
    assert complete("omnibot run --path la") == ["lap-folder.csv", "lap.csv", "lap.toml"]
    assert complete(f"omnibot run --path {tmp_path}/lap.") == [f"{tmp_path}/lap.csv", f"{tmp_path}/lap.toml"]


@pytest.mark.parametrize(
    ("shell", "environment"),
    [
        ("zsh", {"_TYPER_COMPLETE_ARGS": "omnibot run --traction ma"}),
        ("fish", {"_TYPER_COMPLETE_ARGS": "omnibot run --traction ma", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}),
    ],
)
def test_other_shells_are_answered_too(
    omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch, shell: str, environment: dict[str, str]
) -> None:
    monkeypatch.setenv("_OMNIBOT_COMPLETE", f"complete_{shell}")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert "magic" in omnibot().stdout


def test_installed_completion_completes_in_bash(
    omnibot: Omnibot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", shutil.which("bash")))
    assert omnibot("--install-completion").code == 0
    command = ROOT / ".venv" / "bin" / "omnibot"
    script = (
        f"source ~/.bashrc; COMP_WORDS=(omnibot run --order o); COMP_CWORD=3; "
        f"complete -p omnibot; _omnibot_completion {command}; echo ${{COMPREPLY[@]}}"
    )
    said = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True, timeout=60).stdout
    assert said.split("\n")[:2] == ["complete -o default -F _omnibot_completion omnibot", "observer"]
