"""Bus logs as files: read again by python-can's own readers, whole or refused, and never lost."""

import copy
import os
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from host_sim.canlog import Recording, record, write_log
from host_sim.errors import OmnibotError

# What may be the time of a log's first frame: of a simulation, of one that is cut, of the clock with microseconds, and
# with milliseconds of fewer than three digits.
BEGINNINGS = [0.0, 3.25, 1732486000.123456, 1732486000.005001]
TOLERANCE_S = 6e-7  # half a microsecond, and what double precision adds today


def shifted(log: Path, by_s: float) -> list[can.Message]:
    """Return the frames of a log, as candump's reader has them, at other times."""
    with can.CanutilsLogReader(log) as reader:
        frames = [copy.copy(frame) for frame in reader]
    for frame in frames:
        frame.timestamp += by_s
    return frames


def read_by_python_can(path: Path) -> list[can.Message]:
    """Read a log with python-can alone; .asc with the time of its header."""
    options = {"relative_timestamp": False} if path.suffix == ".asc" else {}
    with can.LogReader(path, **options) as reader:
        return list(reader)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
@pytest.mark.parametrize("begin_s", BEGINNINGS)
def test_frames_and_times_are_those_that_python_can_reads(
    tmp_path: Path, recorded_run: Path, suffix: str, begin_s: float
) -> None:
    frames, path = shifted(recorded_run / "bus.log", begin_s)[:1500], tmp_path / f"bus{suffix}"

    assert write_log(frames, path, suffix) == len(frames)

    for read in (read_by_python_can(path), list(Recording(path))):
        assert [(frame.arbitration_id, bytes(frame.data)) for frame in read] == [
            (frame.arbitration_id, bytes(frame.data)) for frame in frames
        ]
        assert [frame.timestamp for frame in read] == pytest.approx(
            [frame.timestamp for frame in frames], rel=0.0, abs=TOLERANCE_S
        )


def test_folder_of_a_run_is_its_bus_log(recorded_run: Path) -> None:
    assert sum(1 for _ in Recording(recorded_run)) == len((recorded_run / "bus.log").read_text().splitlines())


# ---- what is no log


def refusal(path: Path) -> str:
    with pytest.raises(OmnibotError) as refused:
        list(Recording(path))
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_log_that_is_empty_missing_or_garbage_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"bad{suffix}"
    assert "there is no" in refusal(path)
    path.write_bytes(b"")
    assert "is empty" in refusal(path)
    path.write_bytes(bytes(range(256)) * 40)
    assert "cut off" in refusal(path) or "damaged" in refusal(path)
    path.write_bytes(bytes(range(256)) * 40 + b"\n")
    assert "damaged" in refusal(path)
    path.write_text("the quick brown fox\n")
    assert "damaged" in refusal(path) or "no frames" in refusal(path)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
@pytest.mark.parametrize("part", [0.3, 0.7, 0.999])
def test_log_that_is_cut_off_is_refused(tmp_path: Path, recorded_run: Path, suffix: str, part: float) -> None:
    whole, path = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    write_log(Recording(recorded_run), whole, suffix)
    data = whole.read_bytes()
    cut = data[: int(part * len(data))]
    path.write_bytes(cut + b"(" if cut.endswith(b"\n") else cut)
    assert "cut off" in refusal(path)


def test_damaged_line_is_told_by_the_frames_before_it(tmp_path: Path, recorded_run: Path) -> None:
    path = tmp_path / "bad.log"
    lines = (recorded_run / "bus.log").read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:100], "(0.1) vcan0 050#XY\n", *lines[100:]]))
    assert "after frame 100" in refusal(path)


def test_folder_without_a_log_is_refused(tmp_path: Path) -> None:
    assert "the folder of a run" in refusal(tmp_path)


def test_name_that_tells_no_format_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bus.pcap").write_text("anything")
    with pytest.raises(OmnibotError, match=r"\.log, \.asc, \.blf"):
        Recording(tmp_path / "bus.pcap")


# ---- nothing is lost


def test_failed_write_leaves_what_was_there(tmp_path: Path, recorded_run: Path) -> None:
    def failing() -> Iterator[can.Message]:
        yield from list(Recording(recorded_run))[:10]
        raise OmnibotError("damaged")

    out = tmp_path / "out.blf"
    out.write_text("precious")
    with pytest.raises(OmnibotError, match="damaged"):
        write_log(failing(), out, ".blf")
    assert out.read_text() == "precious"
    assert os.listdir(tmp_path) == ["out.blf"]  # noqa: PTH208  # no temporary file either


class CountedBus(can.BusABC):
    """A bus with so many frames on it, after which the user presses Ctrl-C."""

    channel_info = "counted"

    def __init__(self, frames: list[can.Message]) -> None:
        self._frames = iter(frames)
        super().__init__(channel=None)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        frame = next(self._frames, None)
        if frame is None:
            raise KeyboardInterrupt
        return frame, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_recording_that_is_ended_by_ctrl_c_is_whole(tmp_path: Path, recorded_run: Path, suffix: str) -> None:
    frames, path = shifted(recorded_run / "bus.log", 1732486000.25)[:500], tmp_path / "new" / f"bus{suffix}"
    with CountedBus(frames) as bus:
        assert record(bus, path) == 500
    assert [bytes(frame.data) for frame in read_by_python_can(path)] == [bytes(frame.data) for frame in frames]


def test_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_text("precious")
    with CountedBus([]) as bus, pytest.raises(OmnibotError, match="is there already"):
        record(bus, path)
    assert path.read_text() == "precious"
