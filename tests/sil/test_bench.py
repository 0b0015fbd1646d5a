"""The bench's part over a real vcan."""

import subprocess

import pytest

from host_sim.bench.vcan import PINGPONG, measure_vcan


def test_lockstep_cannot_be_faster_than_its_frames() -> None:
    figures = measure_vcan("vcan0")

    assert figures["pingpong_us_per_tick"] > 0.0
    assert 1.0 < figures["vcan_vs_pingpong"] < 100.0


@pytest.mark.parametrize("arguments", [[], ["vcan0", "16", "10"], ["vcan0", "0", "0"], ["vcan0", "0", "-1"]])
def test_pingpong_with_wrong_arguments_says_its_usage(arguments: list[str]) -> None:
    done = subprocess.run([PINGPONG, *arguments], capture_output=True, text=True, check=False)

    assert done.returncode == 2
    assert done.stderr.startswith("usage: omnibot-pingpong INTERFACE NODE TICKS")


def test_pingpong_on_another_interface_names_it() -> None:
    done = subprocess.run([PINGPONG, "vcan9", "0", "10"], capture_output=True, text=True, check=False)

    assert done.returncode == 1
    assert "cannot open vcan9" in done.stderr
