"""The monitor on a bus: in a pipe, on a screen, as a page in a browser; and a bus that fails."""

import io
import json
import math
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
from playwright.sync_api import Browser
from rich.console import Console
from serial_robot import SerialRobot
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.codec import Codec
from host_sim.drive import drive, start_state
from host_sim.errors import OmnibotError
from host_sim.inproc import InprocBus
from host_sim.link import Link
from host_sim.monitor import terminal
from host_sim.monitor.listen import Listener, News, choose_listening, open_listening
from host_sim.monitor.server import MonitorServer, about, updates
from host_sim.monitor.snapshot import Snapshot
from host_sim.monitor.state import MonitorState
from host_sim.planner import PathRequest, plan
from host_sim.plant import Plant
from host_sim.robot import load_robot
from host_sim.run import prepare
from host_sim.scenario import Scenario

ROBOT, CODEC = load_robot(), Codec()
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def frames() -> list[can.Message]:
    """A second around the rhombus' corner, to the middle of the drive."""
    recorded: list[tuple[float, int, bytes]] = []
    request = PathRequest("rhombus", 0.5, "rounded", 2.0, 1.0, 0.3)
    scenario, trajectory = Scenario(request), plan(request)
    plant = Plant(ROBOT, scenario.traction_of(ROBOT))
    plant.reset(*start_state(ROBOT, trajectory))
    with InprocBus() as bus:
        link = Link(bus, CODEC, record=recorded.append)
        prepare(link, ROBOT, scenario, trajectory)
        drive(link, plant, ROBOT, trajectory)
    return [
        can.Message(timestamp=1e9 + time_s, arbitration_id=arbitration_id, data=data, is_extended_id=False)
        for time_s, arbitration_id, data in recorded
        if time_s < 0.8
    ]


class Wire(can.BusABC):
    """A bus that brings what is put into it; it fails where an exception is, and nobody may send."""

    def __init__(self, brings: list[can.Message | Exception]) -> None:
        super().__init__(channel="wire")
        self.brings = brings

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        pytest.fail(f"the monitor has sent {msg}")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.brings:
            time.sleep(min(timeout or 0.0, 0.01))
            return None, False
        brought = self.brings.pop(0)
        if isinstance(brought, Exception):
            raise brought
        return brought, False


def listener_of(*buses: Wire | Exception, node: int = 0) -> Listener:
    waiting = list(buses)

    def open_it() -> can.BusABC:
        opened = waiting.pop(0)
        if isinstance(opened, Exception):
            raise opened
        return opened

    return Listener(MonitorState(Codec(node=node), ROBOT), open_it, retry_s=0.01)


def until(listener: Listener, true: Callable[[Snapshot], bool]) -> Snapshot:
    end_s = time.monotonic() + PATIENCE_S
    while not true(snapshot := listener.snapshot()):
        assert time.monotonic() < end_s, snapshot
        time.sleep(0.01)
    return snapshot


@contextmanager
def heard(frames: list[can.Message]) -> Iterator[Listener]:
    """A listener that has heard all of some frames."""
    with listener_of(Wire(list(frames))) as listener:
        until(listener, lambda snapshot: snapshot.bus.frames == len(frames))
        yield listener


# ---- the bus


def test_bus_that_is_lost_is_opened_again(frames: list[can.Message]) -> None:
    half = len(frames) // 2
    first = Wire([*frames[:half], can.CanOperationError("Network is down")])
    third = Wire(list(frames[half:]))
    with listener_of(first, OmnibotError("no bus 'vcan0'"), third) as listener:
        snapshot = until(listener, lambda snapshot: snapshot.bus.frames == len(frames))
        texts = [event.text for event in listener.news().events]
    assert snapshot.mode == "TRACKING"
    assert snapshot.tracking.unknown == "the upload of the trajectory was not heard"
    assert texts[-2:] == ["the bus is lost: Network is down", "the bus is back"]


def test_bus_that_cannot_be_opened_at_first_is_an_error() -> None:
    with pytest.raises(OmnibotError, match="no bus 'vcan9'"), listener_of(OmnibotError("no bus 'vcan9'")):
        pass


def test_news_come_once(frames: list[can.Message]) -> None:
    with heard(frames) as listener:
        first = listener.news()
        assert len(first.samples) > 30
        assert len(first.events) == first.event_count > 4
        again = listener.news(first.samples[-1].number, first.event_count)
    assert again.samples == again.events == []


@pytest.mark.parametrize("name", ["vcan0", "can"])
def test_serial_port_is_opened_to_listen_only(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the options name it or python-can's configuration."""
    with SerialRobot() as robot:
        monkeypatch.setenv("CAN_INTERFACE", "slcan")
        monkeypatch.setenv("CAN_CHANNEL", robot.port)
        given = (None, None) if name == "can" else ("slcan", robot.port)
        with open_listening(choose_listening(name, *given, None), 0) as bus:
            assert bus.recv(0.1) is None
            assert b"L\r" in robot.heard
            assert b"O\r" not in robot.heard


def test_bit_rate_beside_an_interface_is_what_the_load_is_measured_against() -> None:
    assert choose_listening("vcan0", None, None, 500_000).name == "vcan0"
    with pytest.raises(OmnibotError, match="no bus 'vcan9'"):
        monitor("--bus", "vcan9", "-b", "500000", "--once")


@pytest.mark.parametrize("options", [["--bus", "inproc"], ["--bus", "pil"], ["-i", "omnibot"]])
def test_bus_within_a_run_cannot_be_listened_to(options: list[str]) -> None:
    with pytest.raises(OmnibotError, match="is a bus within a run"):
        monitor(*options, "--once")


# ---- the command


def monitor(*options: str) -> tuple[int, str]:
    outcome = CliRunner().invoke(app, ["monitor", *options])
    if isinstance(outcome.exception, OmnibotError):
        raise outcome.exception
    return outcome.exit_code, outcome.output


@contextmanager
def played(frames: list[can.Message], channel: str) -> Iterator[list[str]]:
    """Frames that come on a virtual bus, again and again; gives the options to hear it."""
    ended = threading.Event()

    def play() -> None:
        with can.Bus(interface="virtual", channel=channel) as bus:
            while not ended.is_set():
                for message in frames:
                    bus.send(can.Message(**{**as_sent(message), "timestamp": 0.0}))
                ended.wait(0.05)

    player = threading.Thread(target=play)
    player.start()
    try:
        yield ["-i", "virtual", "-c", channel]
    finally:
        ended.set()
        player.join()


def as_sent(message: can.Message) -> dict[str, Any]:
    return {"arbitration_id": message.arbitration_id, "data": message.data, "is_extended_id": False}


def test_json_is_one_snapshot(frames: list[can.Message]) -> None:
    with played(frames, "json") as options:
        code, output = monitor(*options, "--json", "--for", "0.5")
    told = json.loads(output)
    assert code == 0
    assert told["mode"] == "TRACKING"
    assert told["bus"]["frames"] > 1000
    assert "mode ARMED → TRACKING" in [event["text"] for event in told["events"]]


def test_once_is_a_page_of_text(frames: list[can.Message]) -> None:
    with played(frames, "once") as options:
        code, output = monitor(*options, "--once", "--for", "0.5")
    assert code == 0
    assert re.search(r"^mode +TRACKING", output, re.MULTILINE)
    assert re.search(r"^torque +[-\d]", output, re.MULTILINE)


def test_silent_bus_is_told_and_fails() -> None:
    with pytest.raises(OmnibotError, match="silent bus: not a frame in 1 s"):
        monitor("-i", "virtual", "-c", "silent", "--once", "--for", "1.1")


def test_wrong_node_is_told_with_the_right_one(frames: list[can.Message]) -> None:
    with (
        played(frames, "node") as options,
        pytest.raises(OmnibotError, match=r"nothing of node 3 .* frames of node 0 are there: try --node"),
    ):
        monitor(*options, "--once", "--node", "3", "--for", "0.5")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["8080"], "8080 is the port of --serve"),
        (["--serve", "--once"], "give one of them"),
        (["--bus", "vcan9"], "no bus 'vcan9'"),
        (["--node", "16", "-i", "virtual"], "node 16: must be 0 … 15"),
    ],
)
def test_wrong_options_are_named(options: list[str], says: str) -> None:
    with pytest.raises(OmnibotError, match=says):
        monitor(*options)


# ---- the terminal


def after(monkeypatch: pytest.MonkeyPatch, rounds: int, end: BaseException) -> None:
    """Have the view look so many times, and then end."""
    left = [rounds]

    def sleep(_: float) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise end

    monkeypatch.setattr(terminal, "sleep", sleep)


def test_pipe_gets_plain_lines_until_ctrl_c(frames: list[can.Message], monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    with heard(frames) as listener:
        after(monkeypatch, 2, KeyboardInterrupt())
        terminal.watch(listener, Console(file=written, width=80, highlight=False), every_s=0.0)
    lines = written.getvalue().splitlines()
    assert "\x1b" not in written.getvalue()
    assert [text.split("  ")[1] for text in lines if "mode " in text][-1] == "mode ARMED → TRACKING"
    states = [text for text in lines if text.startswith("TRACKING, ")]
    assert len(states) == 3
    assert re.search(r"error \d\.\d{3} mm, slip \d\.\d{3}, torque \d\.\d{3} N\*m, bus ", states[0])


def test_notice_is_printed_when_its_words_change(monkeypatch: pytest.MonkeyPatch) -> None:
    state, written = MonitorState(CODEC, ROBOT), io.StringIO()
    instants_s = iter([0.2, 0.4, 1.2, 2.2, 3.2])

    class Silence:
        def news(self, **_: int) -> News:
            return News(state.snapshot(next(instants_s)), [], [], 0)

    after(monkeypatch, 4, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        terminal.watch_in_lines(Silence(), Console(file=written, width=80), 1.0, states=False)  # type: ignore[arg-type]
    assert [text.split(":")[0] for text in written.getvalue().splitlines()] == ["listening", "silent bus"]


def test_screen_is_drawn_until_ctrl_c_and_leaves_the_last_state(
    frames: list[can.Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    written = io.StringIO()
    with heard(frames) as listener:
        after(monkeypatch, 3, KeyboardInterrupt())
        console = Console(file=written, width=80, height=24, force_terminal=True, color_system=None)
        terminal.watch(listener, console, every_s=1.0)
    text = written.getvalue()
    on, off = text.index("\x1b[?1049h"), text.index("\x1b[?1049l")
    assert text[on:off].count("omnibot monitor, node 0") >= 3
    assert "TRACKING" in text[off:]
    assert not re.search(r"\x1b\[[\d;]*3\dm", text), "colours on a terminal without"


def test_dumb_terminal_gets_lines(frames: list[can.Message], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    written = io.StringIO()
    with heard(frames) as listener:
        after(monkeypatch, 1, KeyboardInterrupt())
        terminal.watch(listener, Console(file=written, width=80, force_terminal=True), every_s=0.0)
    assert "\x1b[?1049h" not in written.getvalue()
    assert "\nTRACKING, " in written.getvalue()


# ---- the page


@contextmanager
def served(frames: list[can.Message]) -> Iterator[MonitorServer]:
    with heard(frames) as listener, MonitorServer(listener, ROBOT, 0, 0) as server:
        yield server


def fetch(url: str, **headers: str) -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=PATIENCE_S) as answer:
        body: bytes = answer.read()
        return body


def test_server_gives_a_page_of_its_own_and_the_snapshot(frames: list[can.Message]) -> None:
    with served(frames) as server:
        page = fetch(server.url).decode()
        snapshot = json.loads(fetch(server.url + "snapshot.json"))
        with pytest.raises(urllib.error.HTTPError, match="404"):
            fetch(server.url + "else")
    assert "<canvas" in page
    assert not re.search(r"(src|href)=\"(?!data:)|@import|https?://", page), "the page asks for something"
    assert snapshot["mode"] == "TRACKING"


def test_server_is_for_this_machine_only(frames: list[can.Message]) -> None:
    with served(frames) as server:
        assert server.url.startswith("http://127.0.0.1:")
        with pytest.raises(urllib.error.HTTPError, match="403"):
            fetch(server.url + "snapshot.json", Host="robot.example.org")
        port = int(server.url.rsplit(":", 1)[1].rstrip("/"))
        with socket.socket() as other, pytest.raises(OSError, match="refused"):
            other.connect(("127.0.0.2", port))


def test_second_monitor_on_a_port_is_told_what_to_do(frames: list[can.Message]) -> None:
    with served(frames) as server, listener_of(Wire([])) as second:
        port = int(server.url.rsplit(":", 1)[1].rstrip("/"))
        with pytest.raises(OmnibotError, match=f"port {port} is in use.*--serve {port + 1}"):
            MonitorServer(second, ROBOT, 0, port)


def test_first_update_has_all_and_the_next_what_is_new(frames: list[can.Message]) -> None:
    with heard(frames) as listener:
        stream = updates(listener, threading.Event())
        first, second = json.loads(json.dumps(next(stream), allow_nan=False)), next(stream)
    assert len(first["samples"]) > 30
    start, end = plan(PathRequest("rhombus", 0.5, "rounded", 2.0, 1.0, 0.3)).evaluate([0.0, 1.0], 0)[:, 0, :2]
    assert first["outline"][0] == pytest.approx(start.tolist(), abs=1e-6)
    assert first["outline"][-1] == pytest.approx(end.tolist(), abs=1e-6)
    assert second["samples"] == second["events"] == []
    assert "outline" not in second


def test_wheels_of_the_page_turn_the_robot_as_the_model_says() -> None:
    """A wheel's contact point moves along its drive direction by row i of Jr times the twist."""
    for wheel, row in zip(about(ROBOT, 0)["wheels"], ROBOT.Jr, strict=True):
        direction = (pytest.approx(row[0]), pytest.approx(row[1]))
        angle = wheel["angle_rad"]
        assert (math.cos(angle), math.sin(angle)) == direction
        turned = wheel["x_m"] * row[1] - wheel["y_m"] * row[0]
        assert turned == pytest.approx(row[2])


INK = """(id) => {
    const canvas = document.querySelector(id);
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    let inked = 0;
    for (let place = 3; place < pixels.length; place += 4) inked += pixels[place] > 0;
    return inked / (canvas.width * canvas.height);
}"""


@pytest.mark.parametrize(
    ("width", "height", "more"),
    [(1280, 900, {}), (360, 740, {"is_mobile": True, "has_touch": True}), (1280, 900, {"color_scheme": "dark"})],
    ids=["desk", "phone", "dark"],
)
def test_page_shows_the_robot_and_fits(
    browser: Browser, frames: list[can.Message], width: int, height: int, more: dict[str, Any], tmp_path: Path
) -> None:
    complaints, requests = [], []
    with served(frames) as server:
        told = json.loads(fetch(server.url + "snapshot.json"))
        context = browser.new_context(viewport={"width": width, "height": height}, **more)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(server.url)
        page.wait_for_selector("html[data-drawn]", state="attached", timeout=1e3 * PATIENCE_S)
        page.screenshot(path=tmp_path / "page.png", full_page=True)
        assert page.inner_text("#mode") == "TRACKING"
        assert f"{1e3 * told['tracking']['error_m']:.3f} mm" in page.inner_text("#tiles")
        assert f"{told['speed_m_per_s']:.3f} m/s" in page.inner_text("#tiles")
        assert "mode ARMED → TRACKING" in page.inner_text("#events")
        assert complaints == []
        assert page.evaluate(INK, "#world") > 0.005
        assert all(page.evaluate(INK, f"figure:nth-of-type({n}) canvas") > 0.005 for n in range(1, 5))
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert {url.removeprefix(server.url) for url in requests} <= {"", "events", "data:,"}
        context.close()


def test_page_says_that_the_monitor_has_ended(browser: Browser, frames: list[can.Message]) -> None:
    with served(frames) as server:
        page = browser.new_page()
        page.goto(server.url)
        page.wait_for_selector("html[data-drawn]", state="attached", timeout=1e3 * PATIENCE_S)
    page.wait_for_selector("#mode.lost", timeout=1e3 * PATIENCE_S)
    assert "The monitor has ended" in page.inner_text("#notice")
    page.close()
