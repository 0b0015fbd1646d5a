"""Bus load against the literature, a bit-level encoder, and a bus that is simulated frame by frame."""

import itertools
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from host_sim.busload import Stream, bus_load, response_time, worst_case_bits
from host_sim.cli import app
from host_sim.codec import DBC_FILE, load_messages
from host_sim.errors import OmnibotError
from host_sim.link import BusStatistics

# ---- bits


def crc15(bits: list[int]) -> list[int]:
    """The CRC of a CAN frame, bit by bit (Bosch, CAN specification 2.0, 3.1.1)."""
    register = 0
    for bit in bits:
        flip = bit ^ (register >> 14)
        register = (register << 1) & 0x7FFF
        register ^= 0x4599 if flip else 0
    return [register >> place & 1 for place in reversed(range(15))]


def stuff_bits(bits: list[int]) -> int:
    """How many bits are put in between: one of the other value after five of one, and it counts for the next five."""
    stuffed, run, last = 0, 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed, run, last = stuffed + 1, 1, 1 - bit
    return stuffed


def bits_on_the_wire(identifier: int, data: bytes) -> int:
    """Bits of a classic data frame with an 11-bit identifier, from its first to the end of the space behind it."""

    def word(value: int, width: int) -> list[int]:
        return [value >> place & 1 for place in reversed(range(width))]

    frame = [0, *word(identifier, 11), 0, 0, 0, *word(len(data), 4), *itertools.chain(*(word(x, 8) for x in data))]
    frame += crc15(frame)
    return len(frame) + stuff_bits(frame) + 1 + 2 + 7 + 3  # CRC delimiter, acknowledgement, end of frame, space


def stuffed_pattern(length: int) -> bytes:
    """Data in which every fourth bit is followed by a stuff bit, as long as nothing else breaks the pattern."""
    bits = "".join("1" * 4 + "0" * 4 for _ in range(length))
    return int(bits or "0", 2).to_bytes(length, "big")


def test_crc_of_the_encoder_divides_the_frame() -> None:
    bits = [0, 1, 1, 0, 1, 0, 0, 1] * 5
    assert crc15(bits + crc15(bits)) == [0] * 15


@pytest.mark.parametrize(("length", "bits"), [(0, 55), (1, 65), (4, 95), (7, 125), (8, 135)])
def test_worst_case_bits_are_those_of_the_literature(length: int, bits: int) -> None:
    # Davis, Burns, Bril, Lukkien 2007: 55 + 10 n.
    assert worst_case_bits(length) == bits


@pytest.mark.parametrize("length", range(9))
def test_worst_case_is_that_of_the_worst_bits_that_can_be_stuffed(length: int) -> None:
    stuffable = 34 + 8 * length
    worst = [0, *([0] * 4 + [1] * 4) * 13][:stuffable]

    assert 8 * length + 47 + stuff_bits(worst) == worst_case_bits(length)


@pytest.mark.parametrize("length", range(9))
def test_no_frame_is_longer_than_the_worst_case_and_one_comes_near(length: int) -> None:
    rng = np.random.default_rng(length)
    frames = [(int(rng.integers(2048)), rng.bytes(length)) for _ in range(500)]
    near = [0x000, 0x078, 0x3C1, 0x7C3, 0x7DF, 0x784, 0x43D]
    for identifier, shift in itertools.product([*near, *range(0, 2048, 7)], range(8)):
        rolled = int.from_bytes(stuffed_pattern(length), "big") >> shift
        frames.append((identifier, rolled.to_bytes(length, "big")))

    longest = max(bits_on_the_wire(*frame) for frame in frames)

    # The fixed bits of the control field and the CRC cannot all fall into the pattern.
    assert worst_case_bits(length) - 6 <= longest <= worst_case_bits(length)


def test_a_run_counts_the_same_bits() -> None:
    for length in range(9):
        statistics = BusStatistics()
        statistics.add(length)
        assert statistics.bits == worst_case_bits(length)


# ---- response times


def test_response_times_are_those_of_the_paper() -> None:
    """Its counter-example: the second instance of C is the late one, which the analysis before it did not see."""
    bit = 8  # µs at 125 kbit/s; 125 bits a frame
    streams = [Stream(1000, 2500), Stream(1000, 3500), Stream(1000, 3500)]

    assert [response_time(streams, place, bit) for place in range(3)] == [2000, 3000, 3500]


def simulate(streams: list[Stream], offsets: list[int], horizon: int, busy_until: int = 0) -> list[int]:
    """Largest response time of each stream on a bus that the highest priority gets when it falls free."""
    released = [
        (offset + k * stream.period, place)
        for place, (stream, offset) in enumerate(zip(streams, offsets, strict=True))
        if stream.period is not None
        for k in range(horizon // stream.period)
    ]
    todo, waiting = sorted(released, reverse=True), list[tuple[int, int]]()
    longest, now = [0] * len(streams), busy_until
    while todo or waiting:
        while todo and todo[-1][0] <= now:
            release, place = todo.pop()
            waiting.append((place, release))
        if not waiting:
            now = todo[-1][0]
            continue
        place, release = min(waiting)
        waiting.remove((place, release))
        now += streams[place].duration
        longest[place] = max(longest[place], now - release)
    return longest


def random_streams(rng: np.random.Generator) -> list[Stream]:
    """Some streams that use up to 95 % of the bus."""
    while True:
        count = int(rng.integers(2, 8))
        streams = [
            Stream(int(rng.integers(55, 136)), int(rng.choice([400, 500, 750, 1000, 1250, 2000]))) for _ in range(count)
        ]
        if sum(stream.duration / (stream.period or math.inf) for stream in streams) < 0.95:
            return streams


@pytest.mark.parametrize("seed", range(40))
def test_no_simulated_frame_is_later_than_its_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    streams = random_streams(rng)
    bounds = [response_time(streams, place, 1) for place in range(len(streams))]
    for _ in range(20):
        offsets = [int(rng.integers(stream.period)) for stream in streams]
        measured = simulate(streams, offsets, 60_000)
        assert all(bound is not None and time <= bound for time, bound in zip(measured, bounds, strict=True))


@pytest.mark.parametrize("seed", range(40))
def test_bound_is_met_when_all_are_released_behind_the_longest_below(seed: int) -> None:
    streams = random_streams(np.random.default_rng(100 + seed))
    for place in range(len(streams)):
        below = max((stream.duration for stream in streams[place + 1 :]), default=0)
        above = streams[: place + 1]
        assert simulate(above, [0] * len(above), 60_000, busy_until=below)[place] == response_time(streams, place, 1)


def test_jitter_is_later_by_itself_and_delays_those_below_once_more() -> None:
    # Hand-made: the upper frame 10 of every 100, 95 late: two of them in a row before the lower one's 20.
    streams = [Stream(10, 100, jitter=95), Stream(20, 200)]

    assert response_time(streams, 0, 1) == 95 + 20 + 10
    assert response_time(streams, 1, 1) == 10 + 10 + 20


def test_frames_that_fill_the_bus_leave_those_below_without_bound() -> None:
    streams = [Stream(60, 100), Stream(40, 100), Stream(10, 100)]

    assert response_time(streams, 0, 1) == 100
    assert response_time(streams, 1, 1) is None
    assert response_time([*streams[:2], Stream(10, None)], 2, 1) is None


# ---- the wire definition


def test_our_wire_at_one_megabit_is_within_its_limits() -> None:
    load = bus_load(load_messages(DBC_FILE))

    assert [frame.name for frame in load.tick_frames] == ["POSE", "WHEEL_SPEED", "SYNC", "TORQUE", "SLIP"]
    assert load.bits_per_tick == 665
    assert 0.665 < load.load_fraction < 0.70
    assert load.failures == []
    # Behind the longest below (135), COMMAND (105), POSE, WHEEL_SPEED (135 each), SYNC (125) and its own 135.
    torque = next(frame for frame in load.frames if frame.name == "TORQUE")
    assert torque.response_s == pytest.approx(770e-6)


def test_load_of_cyclic_frames_is_their_bits_over_their_cycles() -> None:
    messages = load_messages(DBC_FILE)
    by_hand = sum((55 + 10 * m.length) / (m.cycle_time * 1e-3) for m in messages if m.cycle_time) / 500_000

    assert bus_load(messages, bit_rate=500_000).load_fraction == pytest.approx(by_hand)
    assert bus_load(messages, nodes=3, bit_rate=500_000).load_fraction == pytest.approx(3 * by_hand)


def test_nodes_take_turns_by_function_and_then_by_node() -> None:
    load = bus_load(load_messages(DBC_FILE), nodes=2)
    identifiers = [frame.arbitration_id for frame in load.frames]

    assert identifiers == sorted(identifiers)
    assert len(set(identifiers)) == 2 * len(load_messages(DBC_FILE))


@pytest.mark.parametrize(("nodes", "bit_rate", "says"), [(0, 1_000_000, "0 nodes: must be 1 … 16"), (1, 5, "5 bit/s")])
def test_arguments_out_of_range_are_refused(nodes: int, bit_rate: int, says: str) -> None:
    with pytest.raises(OmnibotError, match=says):
        bus_load(load_messages(DBC_FILE), nodes, bit_rate)


# ---- the command


def busload(*options: str) -> Result:
    return CliRunner().invoke(app, ["busload", *options])


def test_command_prints_a_row_a_frame() -> None:
    result = busload()

    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) == 2 + len(load_messages(DBC_FILE))


def test_command_gives_the_figures_to_machines() -> None:
    result = busload("--json", "--bitrate", "1000000")

    figures: dict[str, Any] = json.loads(result.stdout)
    assert figures["frames_per_tick"] == 5
    assert 0.665 < figures["load_fraction"] < 0.70


def with_line(tmp_path: Path, old: str, new: str) -> Path:
    """The wire definition with one line changed."""
    text = DBC_FILE.read_text()
    assert text.count(old) == 1
    path = tmp_path / "changed.dbc"
    path.write_text(text.replace(old, new))
    return path


def test_command_fails_above_seventy_percent(tmp_path: Path) -> None:
    path = with_line(tmp_path, 'BA_ "GenMsgCycleTime" BO_ 256 100;', 'BA_ "GenMsgCycleTime" BO_ 256 2;')

    result = busload("--dbc", str(path))

    assert re.fullmatch(r"the load of 7\d\.\d% is above 70%", str(result.exception))


def test_command_fails_at_the_fifth_long_frame(tmp_path: Path) -> None:
    path = with_line(tmp_path, "BO_ 64 SYNC: 7 HOST", "BO_ 64 SYNC: 8 HOST")

    result = busload("--dbc", str(path))

    assert str(result.exception) == "5 frames of 8 bytes a tick; it must be fewer than 5"


def test_command_fails_for_a_frame_that_may_be_too_late(tmp_path: Path) -> None:
    path = with_line(tmp_path, 'BA_ "GenMsgCycleTime" BO_ 256 100;', 'BA_ "GenMsgCycleTime" BO_ 1040 10;')

    result = busload("--dbc", str(path), "--bitrate", "600000")

    assert "too late at the worst: " in str(result.exception)
    assert "SLIP" in str(result.exception)


def test_wire_without_cycle_times_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "none.dbc"
    path.write_text("\n".join(line for line in DBC_FILE.read_text().splitlines() if not line.startswith("BA_ ")))

    result = busload("--dbc", str(path))

    assert "GenMsgCycleTime" in str(result.exception)
