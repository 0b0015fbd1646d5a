"""Many runs on all cores: in order, and ended by Ctrl-C without a loss."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from host_sim.pool import in_processes

# Prints its rows, and once more those that it has when Ctrl-C comes; each case leaves a file when it begins and ends.
PROGRAM = """
import signal, sys, time
from pathlib import Path
from host_sim.pool import in_processes

def run(case):
    Path(sys.argv[1], f"begun-{case}").touch()
    time.sleep(0.05)
    Path(sys.argv[1], f"ended-{case}").touch()
    return case

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started the tests may ignore it
    rows = []
    try:
        for row in in_processes(run, range(1000), jobs=2):
            rows.append(row)
            print(row, flush=True)
    except KeyboardInterrupt:
        print("kept", *rows, flush=True)
"""


def test_rows_come_in_the_order_of_their_cases() -> None:
    assert list(in_processes(abs, range(-20, 0), jobs=2, at_once=3)) == list(range(20, 0, -1))


def test_ctrl_c_keeps_the_rows_and_begins_no_more_cases(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    program = subprocess.Popen(
        [sys.executable, script, tmp_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert program.stdout is not None
    for _ in range(6):
        assert program.stdout.readline()
    os.killpg(program.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    said, complaints = program.communicate(timeout=60)

    kept = said.strip().split("\n")[-1].split()
    assert kept[0] == "kept"
    assert [int(row) for row in kept[1:]] == list(range(len(kept) - 1))
    begun, ended = (len(list(tmp_path.glob(f"{what}-*"))) for what in ("begun", "ended"))
    assert 6 <= len(kept) - 1 <= begun == ended < 100
    assert (complaints, program.returncode) == ("", 0)
