"""The record of a run: layout, file, comparison."""

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.trace import COLUMNS, FILE_NAME, Trace, TraceRecorder, compare, write_atomically


def make_row(k: int) -> dict[str, object]:
    """Row k: every number in it is different, and says where it belongs."""
    widths = {column.name: column.width for column in COLUMNS}
    row: dict[str, object] = {"tick": k}
    for place, (name, width) in enumerate(widths.items()):
        numbers = [1000.0 * k + 10.0 * place + entry for entry in range(width)]
        if name != "tick":
            row[name] = numbers[0] if width == 1 else numbers
    return row


def make_trace(rows: int, capacity: int = 4) -> Trace:
    recorder = TraceRecorder(capacity)
    for k in range(rows):
        recorder.append(**make_row(k))
    return recorder.to_trace()


@pytest.fixture
def trace() -> Trace:
    return make_trace(7)


# Recorder -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [0, 1, 3, 4, 5, 8, 9, 100])
def test_recorder_around_its_capacity_keeps_every_row(rows: int) -> None:
    trace = make_trace(rows, capacity=4)

    assert len(trace) == rows
    for column in COLUMNS:
        expected = [make_row(k)[column.name] for k in range(rows)]
        shape = (rows,) if column.width == 1 else (rows, column.width)
        np.testing.assert_array_equal(trace.column(column.name), np.reshape(expected, shape), err_msg=column.name)


def test_recorder_with_no_capacity_still_grows() -> None:
    assert len(make_trace(3, capacity=0)) == 3


def test_recorder_copies_the_values_given() -> None:
    recorder = TraceRecorder()
    pose = np.zeros(3)
    recorder.append(**{**make_row(0), "pose": pose})
    pose[:] = 9.0

    assert not recorder.to_trace().pose.any()


def test_recorder_after_to_trace_does_not_change_that_trace() -> None:
    recorder = TraceRecorder(4)
    recorder.append(**make_row(0))
    first = recorder.to_trace()
    recorder.append(**make_row(1))

    assert len(first) == 1
    assert len(recorder.to_trace()) == 2


def test_recorder_keeps_the_largest_tick_exactly() -> None:
    recorder = TraceRecorder()
    recorder.append(**{**make_row(0), "tick": 2**32 - 1})

    assert recorder.to_trace().tick[0] == 2**32 - 1


def test_recorder_refuses_a_vector_of_the_wrong_length() -> None:
    with pytest.raises(ValueError, match="broadcast"):
        TraceRecorder().append(**{**make_row(0), "point": [1.0, 2.0, 3.0]})


def test_trace_with_columns_of_unequal_length_is_refused(trace: Trace) -> None:
    with pytest.raises(ValueError, match="column mu is float64 of shape \\(6, 3\\)"):
        replace(trace, mu=trace.mu[:6])


# File ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [0, 1, 7])
def test_save_and_load_give_the_same_bytes(rows: int, tmp_path: Path) -> None:
    trace = make_trace(rows)
    path = trace.save(tmp_path / "new" / "run")

    assert path.name == FILE_NAME
    assert compare(Trace.load(path), trace) == []
    assert compare(Trace.load(path.parent), trace) == []


def test_save_twice_writes_the_same_file(trace: Trace, tmp_path: Path) -> None:
    first, second = trace.save(tmp_path / "a"), trace.save(tmp_path / "b")

    assert first.read_bytes() == second.read_bytes()


def test_save_keeps_numbers_that_are_not_finite(trace: Trace, tmp_path: Path) -> None:
    trace.pose[2] = [np.nan, np.inf, -np.inf]

    assert compare(Trace.load(trace.save(tmp_path)), trace) == []


def test_save_replaces_the_old_file_and_leaves_no_other(trace: Trace, tmp_path: Path) -> None:
    make_trace(3).save(tmp_path)
    trace.save(tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]
    assert len(Trace.load(tmp_path)) == 7


def test_save_below_a_regular_file_names_the_folder_and_a_cure(trace: Trace, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "run"

    with pytest.raises(OmnibotError, match="choose another folder with --out") as caught:
        trace.save(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_write_on_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(_: int) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "x"
    write_atomically(path, b"old")
    monkeypatch.setattr(os, "fsync", no_space)

    with pytest.raises(OmnibotError, match="No space left on device; free some space"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_load_of_no_file_says_what_makes_one(tmp_path: Path) -> None:
    with pytest.raises(OmnibotError, match=r"no trace .*trace.npz; 'omnibot run --out"):
        Trace.load(tmp_path)


def test_load_with_any_byte_damaged_is_refused_or_harmless(trace: Trace, tmp_path: Path) -> None:
    path = trace.save(tmp_path)
    good = path.read_bytes()
    refused = 0
    for place in range(0, len(good), 11):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0x40]) + good[place + 1 :])
        try:
            loaded = Trace.load(path)
        except OmnibotError as error:
            refused += 1
            assert "\n" not in str(error)  # noqa: PT017
        else:  # only the zip file's own bookkeeping may differ unnoticed, never a number
            assert compare(loaded, trace) == []
    assert refused > len(good) / 11 / 2


@pytest.mark.parametrize("keep", [0, 1, 100, 2000, -1])
def test_load_of_a_file_cut_short_is_refused(keep: int, trace: Trace, tmp_path: Path) -> None:
    path = trace.save(tmp_path)
    path.write_bytes(path.read_bytes()[:keep])

    with pytest.raises(OmnibotError, match="is damaged; record the run again"):
        Trace.load(path)


def test_load_without_a_column_names_it(trace: Trace, tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    np.savez(path, **{column.name: trace.column(column.name) for column in COLUMNS if column.name != "mu"})

    with pytest.raises(OmnibotError, match="has no column mu"):
        Trace.load(path)


@pytest.mark.parametrize("wrong", [np.zeros((7, 2)), np.zeros(7), np.zeros((6, 3)), np.zeros((7, 3), np.float32)])
def test_load_with_a_column_of_the_wrong_shape_names_it(wrong: np.ndarray, trace: Trace, tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    np.savez(path, **{column.name: trace.column(column.name) for column in COLUMNS} | {"torque": wrong})

    with pytest.raises(OmnibotError, match=r"column torque is .* instead of float64 of shape \(7, 3\)"):
        Trace.load(path)


def test_load_never_unpickles(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    np.savez(path, tick=np.array([object()]), allow_pickle=True)

    with pytest.raises(OmnibotError, match="damaged"):
        Trace.load(path)


def test_saved_file_is_an_ordinary_npz(trace: Trace, tmp_path: Path) -> None:
    with zipfile.ZipFile(trace.save(tmp_path)) as archive:
        assert archive.namelist() == [f"{column.name}.npy" for column in COLUMNS]


# Comparison ---------------------------------------------------------------------------------------------------------


def test_compare_of_equal_traces_is_empty(trace: Trace) -> None:
    trace.mu[3, 1] = np.nan

    assert compare(trace, make_trace(7)) != []
    assert compare(trace, replace(trace, mu=trace.mu.copy())) == []


@pytest.mark.parametrize("column", [column for column in COLUMNS if column.name != "tick"])
def test_compare_names_a_difference_in_the_last_bit(column: object, trace: Trace) -> None:
    other = make_trace(7)
    array = other.column(column.name).reshape(7, -1)
    array[5, -1] = np.nextafter(array[5, -1], np.inf)

    (line,) = compare(trace, other)

    assert line.startswith(f"{column.name}: 1 of 7 rows differ, first in row 5")
    assert f"largest difference {np.spacing(trace.column(column.name).reshape(7, -1)[5, -1]):.3g}" in line


def test_compare_gives_the_unit_of_the_entry(trace: Trace) -> None:
    for entry, unit in enumerate(["m", "m", "rad"]):
        pose = trace.pose.copy()
        pose[1, entry] += 1.0
        (line,) = compare(trace, replace(trace, pose=pose))
        assert line.endswith(f"largest difference 1 {unit}")


def test_compare_names_a_different_tick(trace: Trace) -> None:
    tick = trace.tick.copy()
    tick[[2, 4]] = [3, 9]

    (line,) = compare(trace, replace(trace, tick=tick))

    assert line == "tick: 2 of 7 rows differ, first in row 2: 2 against 3; largest difference 5"


def test_compare_sees_the_sign_of_zero(trace: Trace) -> None:
    trace.torque[1, 2] = 0.0
    torque = trace.torque.copy()
    torque[1, 2] = -0.0

    (line,) = compare(trace, replace(trace, torque=torque))

    assert "first in row 1, entry 2: 0 against -0; largest difference 0" in line


def test_compare_of_a_number_with_nan_is_infinitely_far(trace: Trace) -> None:
    torque = trace.torque.copy()
    torque[1, 2] = np.nan

    (line,) = compare(trace, replace(trace, torque=torque))

    assert "largest difference inf N*m" in line


def test_compare_of_unequal_lengths_says_so_and_compares_the_rest(trace: Trace) -> None:
    assert compare(trace, make_trace(6)) == ["length: 7 rows against 6"]
    assert compare(trace, make_trace(0)) == ["length: 7 rows against 0"]
