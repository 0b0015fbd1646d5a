"""Other people's programs on vcan0, and how to know that they have heard everything."""

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pyte

from host_sim.codec import Codec
from host_sim.trace import Trace

PYTHON = sys.executable
DEADLINE_S = 60.0  # of a machine that does much else
# A program started by a shell's '&' would not hear Ctrl-C.
HEARS_INTERRUPT = ("env", "--default-signal=INT")

Frame = tuple[int, bytes]
Signals = dict[str, str]
Process = subprocess.Popen[bytes]


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.02)


def sockets_on_vcan0() -> int:
    """How many sockets take everything that goes over vcan0."""
    return len(re.findall(r"^\s*vcan0\s", Path("/proc/net/can/rcvlist_all").read_text(), re.MULTILINE))


def is_waiting(process: Process) -> bool:
    """Whether every thread of a process sleeps: one that has a frame to take would run."""
    states = (
        file.read_text().rpartition(")")[2].split()[0] for file in Path(f"/proc/{process.pid}/task").glob("*/stat")
    )
    return all(state == "S" for state in states)


def wait_until_idle(processes: Iterable[Process]) -> None:
    """Wait until the processes have had nothing to do three times in a row."""
    looks = 0

    def idle() -> bool:
        nonlocal looks
        looks = looks + 1 if all(is_waiting(process) for process in processes) else 0
        return looks == 3

    wait_for(idle, "the listeners never had nothing to do")


class Listeners:
    """Programs that listen on vcan0; each is listening when its `start` returns."""

    def __init__(self) -> None:
        self.processes: list[Process] = []
        self._interrupted: list[Process] = []

    def start(self, *command: str | Path, **options: Any) -> Process:
        before = sockets_on_vcan0()
        process = self.also(*HEARS_INTERRUPT, *command, **options)
        self._interrupted.append(process)
        wait_for(lambda: sockets_on_vcan0() > before or process.poll() is not None, f"{command[0]} does not listen")
        assert process.poll() is None, f"{command} ended before it listened"
        return process

    def also(self, *command: str | Path, **options: Any) -> Process:
        """Start a program that listens to another one's output."""
        self.processes.append(subprocess.Popen(command, **options))
        return self.processes[-1]

    def finish(self) -> None:
        """End them as Ctrl-C does, once they have taken all frames."""
        wait_until_idle(self.processes)
        for process in self._interrupted:
            process.send_signal(signal.SIGINT)
        for process in self.processes:
            process.wait(DEADLINE_S)

    def kill(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@contextlib.contextmanager
def listeners() -> Iterator[Listeners]:
    started = Listeners()
    try:
        yield started
        started.finish()
    finally:
        started.kill()


class Terminal:
    """A terminal for a program that draws on one; read all the time, for a program that draws waits for its reader."""

    def __init__(self, rows: int, columns: int) -> None:
        self._screen = pyte.Screen(columns, rows)
        self._drawn = bytearray()
        self._ours, self._theirs = pty.openpty()
        termios.tcsetwinsize(self._theirs, (rows, columns))
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # EIO: nobody has the terminal open any more
            while drawn := os.read(self._ours, 65536):
                self._drawn += drawn

    def options(self) -> dict[str, Any]:
        """Of Popen: the program on this terminal, and no other."""
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), self._theirs)
        return {**streams, "start_new_session": True, "env": os.environ | {"TERM": "linux"}}

    def lines(self) -> list[str]:
        """What is to be seen, once the program has ended."""
        os.close(self._theirs)
        self._reader.join()
        os.close(self._ours)
        pyte.ByteStream(self._screen).feed(bytes(self._drawn))
        return [line.rstrip() for line in self._screen.display]


# ---- what they say


def frames_of_candump(log: Path) -> list[Frame]:
    """Frames of candump's log format, by hand: '(time) interface identifier#data' and perhaps a direction."""
    words = (line.split()[2].partition("#") for line in log.read_text().splitlines())
    return [(int(identifier, 16), bytes.fromhex(data)) for identifier, _, data in words]


def decoded(lines: Iterable[str]) -> list[tuple[str, Signals]]:
    """Messages as cantools prints them: 'NAME(', then 'signal: value,' a line, then ')'."""
    messages: list[tuple[str, Signals]] = []
    for line in lines:
        if begin := re.search(r"(\w+)\($", line):
            messages.append((begin[1], {}))
        elif value := re.fullmatch(r"\s+(\w+): (.*?),?", line):
            messages[-1][1][value[1]] = value[2]
    return messages


def number(text: str) -> float:
    """The number of a value that may carry its unit."""
    return float(text.split(maxsplit=1)[0])


def once_a_tick(answers: Iterable[Signals]) -> list[Signals]:
    """Without the answers to ticks that were asked again: those that carry the counter of the answer before."""
    kept: list[Signals] = []
    for answer in answers:
        if not kept or answer["counter"] != kept[-1]["counter"]:
            kept.append(answer)
    return kept


def torque_by_tick(frames: Iterable[Frame], codec: Codec) -> list[tuple[float, ...]]:
    """Torque of each wheel, N*m, in the order of the ticks, from the frames of a robot."""
    message = codec["TORQUE"]
    rows = [message.unpack(data) for identifier, data in frames if identifier == message.arbitration_id]
    return [row[:3] for n, row in enumerate(rows) if n == 0 or row[3] != rows[n - 1][3]]


def rows_of(trace: Trace, column: str) -> list[tuple[float, ...]]:
    return [tuple(row) for row in trace.column(column).tolist()]
