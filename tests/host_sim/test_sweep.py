"""The tables of ``omnibot sweep``, a few rows of each really run."""

from collections.abc import Callable
from typing import Any

import pytest

from host_sim.sweep import Case, odometry_cases, robustness_cases, run_case, stability_cases, table


def rows(cases: Callable[[], Any], **labels: Any) -> list[dict[str, Any]]:
    """Run the cases that have these labels."""

    def wanted(case: Case) -> bool:
        return all(case.labels[key] == value for key, value in labels.items())

    found = [run_case(case) for case in cases() if wanted(case)]
    assert found, "no such case"
    return found


@pytest.mark.parametrize("path", ["rhombus", "lemniscate"])
def test_dead_reckoning_with_slip_ends_ten_times_nearer_than_by_encoders_alone(path: str) -> None:
    [encoders] = rows(odometry_cases, path=path, order="0")
    [observer] = rows(odometry_cases, path=path, order="observer")
    assert observer["status"] == "completed"
    assert observer["final_error_m"] < encoders["final_error_m"] / 10.0
    assert observer["max_error_m"] < encoders["max_error_m"] / 50.0


def test_observer_with_counting_encoders_is_eight_times_better_than_order_0() -> None:
    [order0] = rows(robustness_cases, wrong="encoders of 4096 counts", order="0")
    [observer] = rows(robustness_cases, wrong="encoders of 4096 counts", order="observer")
    assert observer["max_error_m"] < order0["max_error_m"] / 8.0


@pytest.mark.parametrize("order", ["1", "3", "exact", "observer"])
@pytest.mark.parametrize("speed", [0.0234, 1.5])
def test_extremes_do_not_diverge_with_the_bounds_on(order: str, speed: float) -> None:
    for epsilon in (1e-11, 0.2, 1.0):
        for row in rows(stability_cases, bounds="on", order=order, speed_m_per_s=speed, epsilon=epsilon):
            assert row["status"] == "completed", row


def test_plain_law_of_the_paper_diverges_at_a_sharp_corner() -> None:
    [row] = rows(
        stability_cases, bounds="off", order="3", speed_m_per_s=1.0, epsilon=0.2, traction="magic", corner="sharp"
    )
    assert row["status"] == "diverged"


def test_grids_hold_every_combination_once() -> None:
    labels = [tuple(case.labels.values()) for case in stability_cases()]
    assert len(labels) == len(set(labels)) == 2 * 5 * 8 * 2 * 2 * 6
    assert len(list(robustness_cases())) == 11 * 6


def test_table_has_a_line_a_row_and_a_gap_where_there_is_no_value() -> None:
    text = table([{"a": 1.0, "b": "x"}, {"a": 2.0, "c": 0.5}])
    assert text.splitlines() == ["| a | b | c |", "| --- | --- | --- |", "| 1 | x | None |", "| 2 | None | 0.5 |"]
