"""The monitor as a web page, for this machine only: a page that needs nothing else, and a stream of events to it.

http.server and server-sent events do it: one way, over plain HTTP, and a browser that lost the stream asks again.
"""

import errno
import json
import math
import threading
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from types import TracebackType
from typing import Any, Self

from host_sim.errors import OmnibotError
from host_sim.monitor.listen import Listener
from host_sim.monitor.text import notice, rows
from host_sim.robot import Robot

HOST = "127.0.0.1"
DEFAULT_PORT = 8047
UPDATES_PER_S = 12.0
STOP_LOOK_S = 0.05
# A page of elsewhere whose name was made to point here must not read the robot.
OWN_NAMES = {"127.0.0.1", "localhost"}
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:"


def page() -> bytes:
    """Return the page with its style and script in it."""
    folder = resources.files("host_sim.monitor")
    html, css, script = (folder.joinpath(f"page.{kind}").read_text(encoding="utf-8") for kind in ("html", "css", "js"))
    return html.replace("/* style */", css).replace("/* script */", script).encode()


def about(robot: Robot, node: int) -> dict[str, Any]:
    """Return what the page draws the robot with: wheels by place and drive direction in the body's frame, m and rad."""
    wheels = []
    for drive_x, drive_y, arm_m in robot.Jr.tolist():
        # Turning by w moves a wheel at (x, y) along its drive direction by w (x dy - y dx), which is w times its arm.
        wheels.append({"x_m": arm_m * drive_y, "y_m": -arm_m * drive_x, "angle_rad": math.atan2(drive_y, drive_x)})
    return {
        "node": node,
        "wheels": wheels,
        "wheel_radius_m": robot.wheel_radius_m,
        "body_radius_m": robot.wheel_distance_m,
        "tracked_point_m": robot.tracked_point_offset_m,
    }


def updates(listener: Listener, stopped: threading.Event) -> Iterator[dict[str, Any]]:
    """Yield what is new since the update before, until the server stops; the first one has all there is."""
    sample, event, outline = 0, 0, None
    while not stopped.is_set():
        news = listener.news(sample, event)
        sample = news.samples[-1].number if news.samples else sample
        event = news.event_count
        update: dict[str, Any] = {
            "state": news.snapshot.as_dict(),
            "notice": notice(news.snapshot),
            "rows": [[row.name, row.text, row.mood.name.lower()] for row in rows(news.snapshot)],
            "samples": [finite(entry) for entry in news.samples],
            "events": [finite(entry) for entry in news.events],
        }
        newest = listener.outline()
        if newest != outline:
            outline = newest
            update["outline"] = outline
        yield update
        stopped.wait(1.0 / UPDATES_PER_S)


def finite(value: Any) -> Any:
    """Return nested values with None for every number that JSON does not have."""
    if isinstance(value, (tuple, list)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class MonitorServer:
    """Serves a listener's news on a port of this machine while it is entered; port 0 takes a free one."""

    def __init__(self, listener: Listener, robot: Robot, node: int, port: int = DEFAULT_PORT) -> None:
        self._stopped = threading.Event()
        handler = type("Handler", (_Handler,), {"listener": listener, "stopped": self._stopped, "body": page()})
        handler.about = about(robot, node)  # type: ignore[attr-defined]
        try:
            self._server = ThreadingHTTPServer((HOST, port), handler)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise OmnibotError(
                    f"port {port} is in use, by another monitor perhaps: give this one another, --serve {port + 1}"
                ) from error
            raise OmnibotError(f"cannot serve on port {port}: {error.strerror}; give one of 1024 … 65535") from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(STOP_LOOK_S,), name="monitor-server", daemon=True
        )

    @property
    def url(self) -> str:
        """Return where the page is."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    """Answers for one connection; what it serves stands in its class."""

    listener: Listener
    stopped: threading.Event
    body: bytes
    about: dict[str, Any]
    timeout = 10.0  # for a client that does not say what it wants

    def do_GET(self) -> None:
        """Answer a request."""
        if self.headers.get("Host", "").rsplit(":", 1)[0] not in OWN_NAMES:
            self.send_error(HTTPStatus.FORBIDDEN, "this page is for this machine only")
        elif self.path == "/":
            self._send("text/html; charset=utf-8", self.body)
        elif self.path == "/snapshot.json":
            snapshot = self.listener.snapshot().as_dict()
            self._send("application/json", json.dumps(snapshot, allow_nan=False).encode())
        elif self.path == "/events":
            self._stream()
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "there are /, /events and /snapshot.json")

    def _begin(self, kind: str, length: int | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()

    def _send(self, kind: str, body: bytes) -> None:
        self._begin(kind, len(body))
        self.wfile.write(body)

    def _stream(self) -> None:
        """Send events until the client goes or the server stops."""
        try:
            self._begin("text/event-stream")
            self._event("about", self.about)
            for update in updates(self.listener, self.stopped):
                self._event("update", update)
        except OSError:
            return  # the page was closed

    def _event(self, name: str, data: dict[str, Any]) -> None:
        self.wfile.write(f"event: {name}\ndata: {json.dumps(data, allow_nan=False)}\n\n".encode())
        self.wfile.flush()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Say nothing of requests: the terminal is for the robot."""
