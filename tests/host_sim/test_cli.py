"""The installed command as a user meets it: one line for every mistake, nothing lost, nothing mixed."""

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from host_sim.robot import ROOT

SHORT = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2"]
COMMAND = [sys.executable, "-c", "from host_sim.cli import main; main()"]


def omnibot(*arguments: str, file_size: int | None = None, cwd: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    """Run the command; ``file_size`` stands for a full disk."""

    def limit() -> None:
        if file_size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))

    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=120, check=False, preexec_fn=limit, cwd=cwd
    )


def assert_one_line(result: "subprocess.CompletedProcess[str]", says: str) -> None:
    assert result.returncode == 1
    assert says in result.stderr
    assert result.stderr.startswith("omnibot: ")
    assert result.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let the plant be compiled and kept, so that a limit of file sizes meets the run's own files."""
    assert omnibot("run", *SHORT, "--out", str(tmp_path_factory.mktemp("warm"))).returncode == 0


def test_brackets_of_the_user_are_printed_as_they_are() -> None:
    assert_one_line(omnibot("run", "--path", "[/x] [bold]y"), "'[/x] [bold]y'")


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("file_size", [2_000, 30_000, 200_000])
def test_full_disk_is_told_and_leaves_no_result(tmp_path: Path, file_size: int) -> None:
    result = omnibot("run", *SHORT, "--out", str(tmp_path), file_size=file_size)
    assert_one_line(result, "--out")
    assert not (tmp_path / "result.json").exists()


def test_failed_run_leaves_nothing_of_the_run_before_it(tmp_path: Path) -> None:
    assert omnibot("run", *SHORT, "--out", str(tmp_path)).returncode == 0
    failed = omnibot("run", *SHORT, "-i", "virtual", "-c", "nobody", "--timeout", "0.3", "--out", str(tmp_path))
    assert_one_line(failed, "no IDENTITY")
    assert {file.name for file in tmp_path.iterdir()} & {"result.json", "trace.npz", "report.html"} == set()


def test_second_run_into_the_same_folder_is_refused(tmp_path: Path) -> None:
    first = subprocess.Popen(
        [*COMMAND, "run", *SHORT, "--pace", "0.3", "--out", str(tmp_path)], stdout=subprocess.DEVNULL, cwd=ROOT
    )
    try:
        while not (tmp_path / "bus.log").exists():
            assert first.poll() is None
        assert_one_line(omnibot("run", *SHORT, "--out", str(tmp_path)), "another run writes into")
    finally:
        assert first.wait(timeout=60) == 0
    assert json.loads((tmp_path / "result.json").read_text())["status"] == "completed"


@pytest.mark.parametrize("length", [0, 500, 1000, 2000, 3000])
def test_damaged_wire_definition_is_refused_by_name(tmp_path: Path, length: int) -> None:
    damaged = tmp_path / "damaged.dbc"
    damaged.write_bytes((ROOT / "protocol" / "omnibot.dbc").read_bytes()[:length])
    result = omnibot("run", *SHORT, "--dbc", str(damaged))
    assert result.returncode == 1
    assert "wire definition" in result.stderr
    assert "Traceback" not in result.stderr


def test_error_as_json_is_json() -> None:
    result = omnibot("run", "--path", "spiral", "--json")
    assert result.returncode == 1
    assert json.loads(result.stdout)["status"] == "error"


def test_run_works_from_anywhere(tmp_path: Path) -> None:
    result = omnibot("run", *SHORT, "--out", "here", "--json", cwd=tmp_path)
    assert json.loads(result.stdout)["status"] == "completed"
    assert (tmp_path / "here" / "report.html").exists()


def test_results_without_a_folder_go_below_the_one_that_the_user_is_in(tmp_path: Path) -> None:
    for _ in range(2):
        assert json.loads(omnibot("run", *SHORT, "--json", cwd=tmp_path).stdout)["status"] == "completed"
    assert len(list(tmp_path.glob("runs/*-rhombus*/report.html"))) == 2


def test_unknown_sweep_and_bus_name_what_there_is() -> None:
    assert_one_line(omnibot("sweep", "floors"), "robustness")
    assert_one_line(omnibot("run", "--bus", "lo"), "tools/with-vcan")


@pytest.mark.usefixtures("compiled")
def test_compare_writes_a_page_and_its_exit_code_is_that_of_diff(tmp_path: Path) -> None:
    for name, order in (("a", "1"), ("b", "1"), ("c", "2")):
        assert omnibot("run", *SHORT, "--order", order, "--out", str(tmp_path / name)).returncode == 0
    page = tmp_path / "page"
    same = omnibot("compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(page))
    assert same.returncode == 0
    assert f"report: {page / 'report.html'}" in same.stdout
    assert "agree in every array, all 1201 ticks, byte for byte" in same.stdout
    three = omnibot("compare", *(str(tmp_path / name) for name in "abc"), "--out", str(page))
    assert_one_line(three, "a and c differ in")
    assert "c: pose: " in three.stdout
    assert "b: " not in three.stdout


def test_compare_of_one_run_and_of_damaged_results_says_what_is_wrong(tmp_path: Path) -> None:
    assert_one_line(omnibot("compare", str(tmp_path)), "needs a second run")
    assert_one_line(omnibot("compare", str(tmp_path), str(tmp_path)), "there is no trace")
    assert omnibot("run", *SHORT, "--out", str(tmp_path)).returncode == 0
    (tmp_path / "result.json").write_text("{")
    assert_one_line(omnibot("compare", str(tmp_path), str(tmp_path)), "result.json is damaged")
