"""The monitor beside a run on a real vcan: it sees the run, and the run does not see it."""

import json
import re
import signal
import subprocess
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from typer.testing import CliRunner

from host_sim.bus_choice import BusChoice
from host_sim.cli import app
from host_sim.codec import DBC_FILE
from host_sim.errors import OmnibotError
from host_sim.monitor.command import look_once, make_listener
from host_sim.monitor.listen import open_listening
from host_sim.robot import ROOT
from host_sim.trace import Trace, compare

Start = Callable[..., "subprocess.Popen[bytes]"]
OMNIBOT = ROOT / ".venv" / "bin" / "omnibot"
CORNER = ["--speed", "0.5", "--start-before-corner", "0.3", "--duration", "1.2"]
PATIENCE_S = 60.0
RESOLUTION_m = 2e-5  # of a point on the wire


def omnibot(*arguments: str) -> str:
    outcome = CliRunner().invoke(app, list(arguments))
    if outcome.exception is not None and not isinstance(outcome.exception, SystemExit):
        raise outcome.exception
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


def snapshot_when(url: str, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The served snapshot, once it is as wanted."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        with urllib.request.urlopen(url + "snapshot.json", timeout=PATIENCE_S) as answer:
            snapshot: dict[str, Any] = json.load(answer)
        if true(snapshot):
            return snapshot
        assert time.monotonic() < end_s, snapshot
        time.sleep(0.05)


class Watcher(threading.Thread):
    """Looks at the page's snapshot in the middle of a run, and then as a second monitor that has come late."""

    def __init__(self, url: str) -> None:
        super().__init__()
        self.url = url
        self.seen: dict[str, Any] = {}
        self.late: dict[str, Any] = {}

    def run(self) -> None:
        self.seen = snapshot_when(self.url, lambda snapshot: snapshot["tracking"]["error_m"] is not None)
        with make_listener(lambda: open_listening(BusChoice("vcan0"), 0), 0, None, DBC_FILE) as listener:
            self.late = json.loads(look_once(listener, 0.5, as_json=True)[0])


def test_monitors_see_a_run_and_do_not_disturb_it(tmp_path: Path, start_firmware: Start) -> None:
    omnibot("run", *CORNER, "--out", str(tmp_path / "alone"))
    command = [OMNIBOT, "monitor", "--bus", "vcan0", "--serve", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as serving:
        assert serving.stdout is not None
        found = re.search(r"http://127\.0\.0\.1:(\d+)/", serving.stdout.readline())
        assert found is not None
        url, port = found[0], found[1]
        with pytest.raises(OmnibotError, match=f"port {port} is in use"):
            omnibot("monitor", "--bus", "vcan0", "--serve", port)
        assert snapshot_when(url, lambda snapshot: snapshot["bus"]["silent_s"] > 1.5)["bus"]["frames"] == 0
        start_firmware()
        watcher = Watcher(url)
        watcher.start()
        omnibot("run", *CORNER, "--bus", "vcan0", "--pace", "0.3", "--out", str(tmp_path / "seen"))
        watcher.join()
        end = snapshot_when(url, lambda snapshot: snapshot["mode"] not in ("ARMED", "TRACKING"))
        serving.send_signal(signal.SIGINT)
        said = serving.stdout.read()
        assert serving.wait(timeout=PATIENCE_S) == 0

    assert compare(Trace.load(tmp_path / "seen"), Trace.load(tmp_path / "alone")) == []
    result = json.loads((tmp_path / "seen" / "result.json").read_text())
    for words in ("silent bus", "mode ARMED → TRACKING", f"firmware {result['versions']['firmware']}"):
        assert words in said
    seen, late = watcher.seen, watcher.late
    assert (seen["mode"], seen["drive"], seen["bus"]["damaged_frames"]) == ("TRACKING", "LOCKSTEP", 0)
    assert seen["tracking"]["error_m"] <= result["tracking"]["max_error_m"] + RESOLUTION_m
    assert end["tracking"]["max_error_m"] == pytest.approx(result["tracking"]["max_error_m"], abs=RESOLUTION_m)
    assert end["max_torque_Nm"] == result["torque"]["max_Nm"]
    assert end["bus"]["frames"] + end["bus"]["unheard_frames"] >= result["bus"]["frames"]
    assert late["mode"] == "TRACKING"
    assert late["tracking"]["unknown"] == "the upload of the trajectory was not heard"
    assert 0.0 < late["bus"]["load_fraction"] < 0.67
    assert 0.0 < late["pace"] < 0.5


def test_monitor_sends_nothing() -> None:
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        with pytest.raises(OmnibotError, match="silent bus: not a frame in 1 s"):
            omnibot("monitor", "--once", "--for", "1.2")
        assert bus.recv(0.0) is None
