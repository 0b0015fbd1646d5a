"""tools/coverage judges a report of gcovr's layer by layer, and lists what was missed."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
TOOL = str(ROOT / "tools" / "coverage")
LAYERS = ("firmware/control/a.c", "firmware/app/b.c", "protocol/c.c")


def line(number: int, count: int, branches: tuple[int, ...] = ()) -> dict[str, Any]:
    return {"line_number": number, "count": count, "branches": [{"count": n} for n in branches]}


def judge(tmp_path: Path, **lines: list[dict[str, Any]]) -> "subprocess.CompletedProcess[str]":
    """Judge a report in which a layer has these lines, each other layer one line that was run."""
    files = [{"file": file, "lines": lines.get(file.split("/")[-2], [line(1, 1)])} for file in LAYERS]
    report = tmp_path / "report.json"
    report.write_text(json.dumps({"files": files}))
    return subprocess.run([sys.executable, TOOL, str(report)], capture_output=True, text=True, check=False, timeout=60)


def test_everything_run_passes(tmp_path: Path) -> None:
    result = judge(tmp_path, app=[line(1, 7, (3, 4)), line(2, 3)])

    assert result.returncode == 0, result.stdout
    assert "ok   app: lines 2 of 2 (100.0 %), branches 2 of 2 (100.0 %)" in result.stdout


def test_line_that_was_not_run_fails_its_layer_alone(tmp_path: Path) -> None:
    result = judge(tmp_path, app=[line(n, 1) for n in range(1, 1000)] + [line(1000, 0)])

    assert result.returncode == 1
    assert "FAIL app: lines 999 of 1000 (99.9 %)" in result.stdout
    assert "     firmware/app/b.c:1000: never run" in result.stdout.splitlines()
    assert "ok   control" in result.stdout
    assert "ok   protocol" in result.stdout


def test_branches_one_below_the_limit_fail(tmp_path: Path) -> None:
    result = judge(tmp_path, control=[line(1, 9, (1,) * 94 + (0,) * 6)])

    assert result.returncode == 1
    assert "FAIL control: lines 1 of 1 (100.0 %), branches 94 of 100 (94.0 %)" in result.stdout
    assert "     firmware/control/a.c:1: 6 of 100 branches never taken" in result.stdout.splitlines()


def test_branches_at_the_limit_pass_and_are_listed(tmp_path: Path) -> None:
    result = judge(tmp_path, control=[line(1, 9, (1,) * 95 + (0,) * 5)])

    assert result.returncode == 0
    assert "     firmware/control/a.c:1: 5 of 100 branches never taken" in result.stdout.splitlines()


def test_excluded_line_counts_for_nothing(tmp_path: Path) -> None:
    excluded = line(2, 0) | {"gcovr/excluded": True}

    assert judge(tmp_path, protocol=[line(1, 1), excluded]).returncode == 0


def test_layer_without_a_line_fails(tmp_path: Path) -> None:
    result = judge(tmp_path, protocol=[])

    assert result.returncode == 1
    assert "FAIL protocol: lines 0 of 0" in result.stdout


def test_missing_report_is_named() -> None:
    result = subprocess.run(
        [sys.executable, TOOL, "nowhere.json"], capture_output=True, text=True, check=False, timeout=60
    )

    assert result.returncode == 1
    assert result.stderr == "coverage: there is no nowhere.json\n"
