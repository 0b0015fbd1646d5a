"""Logs of a bus as files: candump's ``.log``, and Vector's ``.asc`` and ``.blf``, through python-can.

Times are kept to the microsecond: those of a simulation, which begin at 0, and those of the clock alike.
"""

import contextlib
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

import can
from can.io.generic import MessageWriter

from host_sim.errors import OmnibotError

SUFFIXES = (".log", ".asc", ".blf")
TEXT_SUFFIXES = (".log", ".asc")
LISTEN_S = 0.2

# A time below this one, the beginning of 1990, is not of the clock: python-can's BLF says so as well.
CLOCK_BEGIN_S = 631152000.0


def check_suffix(path: Path) -> None:
    """Refuse a file whose name does not tell a format that is written and read here."""
    if path.suffix.lower() not in SUFFIXES:
        raise OmnibotError(f"{path}: the name of a bus log must end in {', '.join(SUFFIXES)}")


class Recording:
    """A bus log in a file, that can be read as often as need be, a frame at a time.

    Parameters
    ----------
    path
        The log, or the folder of a run with its ``bus.log``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / "bus.log" if path.is_dir() else path
        if not self.path.exists():
            raise OmnibotError(f"there is no {self.path}: give a bus log, or the folder of a run")
        check_suffix(self.path)

    def __iter__(self) -> Iterator[can.Message]:
        """Yield every frame; OmnibotError where the file is no log, empty or cut off."""
        self._check_end()
        frames = 0
        try:
            with self._reader() as reader:
                for message in reader:
                    frames += 1
                    yield message
        except OmnibotError:
            raise
        except OSError as error:
            raise OmnibotError(f"cannot read {self.path}: {error.strerror or error}") from error
        except Exception as error:  # python-can's readers raise whatever a damaged file makes them
            raise OmnibotError(
                f"{self.path} is damaged, or no {self.path.suffix} log, after frame {frames}: "
                f"{error or type(error).__name__}"
            ) from error
        if frames == 0:
            raise OmnibotError(f"{self.path} holds no frames: is it a bus log?")

    @contextlib.contextmanager
    def _reader(self) -> Iterator[Iterable[can.Message]]:
        # python-can leaves a file open that it cannot read, and gives times of an .asc from the log's beginning on.
        suffix = self.path.suffix.lower()
        if suffix == ".blf":
            with self.path.open("rb") as file:
                reader = can.BLFReader(file)
                yield reader
                self._check_blf(reader)
        else:
            with self.path.open(encoding="utf-8") as text:
                yield can.ASCReader(text, relative_timestamp=False) if suffix == ".asc" else can.CanutilsLogReader(text)

    def _check_end(self) -> None:
        """Refuse a text that ends within a line: its last frame is not the one that was on the bus."""
        try:
            with self.path.open("rb") as file:
                if file.seek(0, os.SEEK_END) == 0:
                    raise OmnibotError(f"{self.path} is empty: nothing was recorded")
                file.seek(-1, os.SEEK_END)
                ended = file.read() == b"\n"
        except OSError as error:
            raise OmnibotError(f"cannot read {self.path}: {error.strerror or error}") from error
        if self.path.suffix.lower() in TEXT_SUFFIXES and not ended:
            raise OmnibotError(
                f"{self.path} is cut off in its last line, or no text: remove that line, or record again"
            )

    def _check_blf(self, reader: can.BLFReader) -> None:
        """Refuse a file that is shorter than its header says: python-can reads what there is without a word."""
        size = self.path.stat().st_size
        if reader.file_size > size:
            raise OmnibotError(f"{self.path} is cut off: {size} of {reader.file_size} bytes are there; record again")


class LogFile:
    """A bus log that is being written, in the format that its name tells.

    Parameters
    ----------
    path
        Where; the suffix tells the format.
    suffix
        The format, if the name does not tell it.
    """

    def __init__(self, path: Path, suffix: str | None = None) -> None:
        self._path = path
        self._suffix = (suffix or path.suffix).lower()
        self._writer: MessageWriter | None = None
        self.frames = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def write(self, message: can.Message) -> None:
        """Add a frame; times must not go back."""
        if self._writer is None:
            self._writer = self._begin(message.timestamp)
        self._writer.on_message_received(message)
        self.frames += 1

    def close(self) -> None:
        """Finish the file."""
        if self._writer is None:
            self._writer = self._begin(0.0)
        self._writer.stop()

    def _begin(self, first_s: float) -> MessageWriter:
        """Open the file with a beginning from which its times can be told again.

        Both of Vector's formats count from it. python-can takes the first frame's time, of which it keeps milliseconds
        at best, and none where it is not of the clock: so a whole second does, or zero.
        """
        begin_s = float(int(first_s)) if first_s >= CLOCK_BEGIN_S else 0.0
        if self._suffix == ".blf":
            blf = can.BLFWriter(self._path)
            blf.start_timestamp = begin_s
            return blf
        if self._suffix == ".asc":
            asc = can.ASCWriter(self._path)
            asc.log_event("Start of measurement", begin_s)
            return asc
        return can.CanutilsLogWriter(self._path, channel="vcan0")


def write_log(messages: Iterable[can.Message], path: Path, suffix: str) -> int:
    """Write frames as a log, whole or not at all; returns how many."""
    with whole_file(path) as temporary, LogFile(temporary, suffix) as log:
        for message in messages:
            log.write(message)
    return log.frames


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a file to write that takes its place when it is whole; until then, and after an error, what was stays."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise OmnibotError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def record(bus: can.BusABC, path: Path, duration_s: float | None = None) -> int:
    """Write all that is on a bus into a new log until Ctrl-C, or for some time; returns how many frames."""
    check_suffix(path)
    if path.exists():
        raise OmnibotError(f"{path} is there already, and a recording cannot be had again: choose another name")
    end_s = None if duration_s is None else time.monotonic() + duration_s
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with LogFile(path) as log, contextlib.suppress(KeyboardInterrupt):
            while end_s is None or time.monotonic() < end_s:
                message = bus.recv(LISTEN_S)
                if message is not None:
                    log.write(message)
    except can.CanError as error:
        raise OmnibotError(f"cannot receive from {bus.channel_info}: {error}") from error
    except OSError as error:
        raise OmnibotError(f"cannot write {path}: {error.strerror or error}") from error
    return log.frames
