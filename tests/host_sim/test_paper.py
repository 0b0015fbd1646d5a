"""The paper beside ours: its formulas, one speed of Table 1 really run, the page, and what a user does wrong."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.errors import OmnibotError
from host_sim.paper import ITEMS, choose, published, write_paper
from host_sim.paper.cost import firmware_step_times_s, measure_cost
from host_sim.paper.deviation import table1_cells, table1_numbers
from host_sim.paper.fast_variable import implied_force_N
from host_sim.paper.section import Section, Table, figure_text, length_text
from host_sim.paper.simulate import Case, Simulator
from host_sim.paper.stability import BOUNDS_ON, bounds_off, case_of, largest_tracking, tracks
from host_sim.robot import load_robot
from host_sim.trace import compare

ROBOT = load_robot()


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(ROBOT)


# ---- formulas


def test_curves_of_fig_2_at_known_points() -> None:
    # (4) at 100 s = 5: B x = 0.89, 0.568 B x + 0.432 atan B x = 0.8197, 2193 N sin(1.65 atan 0.8197);
    # (5) at 5 degrees: B x = 1.22, 1.132 B x − 0.132 atan B x = 1.2643, 1936 N sin(1.30 atan 1.2643).
    force = published.longitudinal_force_N(np.array([0.0, 0.05, -0.05]))
    assert force == pytest.approx([0.0, 1986.1, -1986.1], abs=0.5)
    assert published.lateral_force_N(np.array([0.0, 5.0, -5.0])) == pytest.approx([0.0, 1784.1, -1784.1], abs=0.5)


def test_curves_of_fig_2_peak_at_D_and_start_with_the_slope_of_6_and_7() -> None:
    x = np.linspace(-15.0, 15.0, 30001)
    assert published.longitudinal_force_N(x / 100.0).max() == pytest.approx(2193.0, rel=1e-6)
    assert published.lateral_force_N(x).max() == pytest.approx(1936.0, rel=1e-6)
    small = np.array([1e-6])
    assert published.longitudinal_force_N(small)[0] / 1e-6 == pytest.approx(published.longitudinal_stiffness_N())
    assert published.lateral_force_N(small)[0] / 1e-6 == pytest.approx(published.lateral_stiffness_N())


def test_epsilon_of_34() -> None:
    assert published.epsilon_of(0.4, 5) == pytest.approx(5e-5)
    assert published.epsilon_of(0.0, 8) == pytest.approx(1e-8)
    assert published.epsilon_of(0.8, 11) == pytest.approx(9e-11)
    grid = published.epsilon_grid()
    assert grid == sorted(grid)
    assert grid[0] == pytest.approx(1e-9)
    assert grid[-1] == pytest.approx(1e-2)
    assert any(epsilon == pytest.approx(5e-5) for epsilon in grid)


def test_predicted_epsilon_star() -> None:
    assert published.predicted_epsilon_star(ROBOT, 23.0, 0.5) == pytest.approx(0.75 / (23.0 * 1.903 * 0.5))


def test_force_that_the_papers_mu_stands_for() -> None:
    # Row 2 of Γ: −1/2 + b² beside 1 + b² + r².
    by_hand = abs((0.12**2 - 0.5) * 150.0 + (1.0 + 0.12**2 + 0.0349**2) * -200.0) / 0.0936
    assert implied_force_N(ROBOT) == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (5e-5, "5·10⁻⁵"), (4e-11, "4·10⁻¹¹"), (0.03421, "0.0342"), (2917.2, "2920")]
)
def test_figure_text(value: float, text: str) -> None:
    assert figure_text(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(4.66e-5, "46.6 µm"), (5.564e-4, "0.556 mm"), (0.1423, "14.2 cm"), (1.4817, "1.48 m")]
)
def test_length_text(value: float, text: str) -> None:
    assert length_text(value) == text


# ---- runs


def test_table1_is_far_below_the_papers_flexible_column(simulator: Simulator) -> None:
    numbers = table1_numbers(simulator, (0.0936,))
    (row,) = numbers["table1"]
    assert set(row) == {"speed_m_per_s", "paper_m", "ours_m"}
    assert row["paper_m"] == 0.1423
    assert 0.0 < row["ours_m"] < row["paper_m"] / 8.0
    cells = numbers["table1_all"]
    assert len(cells) == len(table1_cells((0.0936,))) == 12
    assert all(cell["status"] == "completed" for cell in cells)
    sharp = {(c["epsilon"], c["order"]): c["ours_m"] for c in cells if c["corner"] == "sharp"}
    assert sharp[4e-11, "1"] == pytest.approx(3.26e-3, rel=0.02)  # theory, 'What a correct closed loop does'
    assert sharp[0.0, "1"] == pytest.approx(sharp[4e-11, "1"], rel=1e-6)


def test_run_is_the_same_each_time_and_kept() -> None:
    case = Case(0.5, 0.01, start_before_corner_s=0.3, duration_s=0.8)
    first, second = Simulator(ROBOT), Simulator(ROBOT)
    assert compare(first.run(case).trace, second.run(case).trace) == []
    assert first.run(case) is first.run(case)


def test_stability_is_told_from_oscillation_and_loss(simulator: Simulator) -> None:
    off = bounds_off(ROBOT)
    assert tracks(simulator.run(case_of("1", 5e-5, off)))
    assert tracks(simulator.run(case_of("1", 0.02, off)))
    assert not tracks(simulator.run(case_of("exact", 0.1, off)))
    assert not tracks(simulator.run(case_of("exact", 0.1, BOUNDS_ON)))
    assert tracks(simulator.run(case_of("observer", 0.1, BOUNDS_ON)))


@pytest.mark.parametrize(("limit", "found"), [(0.5, 0.0), (1.0, 1.0), (3.5, 3.0), (7.9, 7.0), (8.0, math.inf)])
def test_largest_tracking_bisects(limit: float, found: float) -> None:
    assert largest_tracking(lambda epsilon: epsilon <= limit, np.arange(1.0, 9.0)) == found


def test_cost_counts_the_plant_and_every_step_of_the_firmware(simulator: Simulator) -> None:
    case = Case(0.5, 0.01, start_before_corner_s=0.3, duration_s=0.8)
    outcome, sent = simulator.run_recorded(case)
    times_s = firmware_step_times_s(sent)
    assert len(times_s) == len(outcome.trace)
    assert min(times_s) > 0.0
    cost = measure_cost(simulator, 1e-8)
    assert 1000.0 <= cost.steps_per_s < cost.evaluations_per_s < 1e5


# ---- what is written


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper")
    outcome = CliRunner().invoke(app, ["paper", "--only", "fig4,fig2", "--out", str(folder), "--json"])
    assert outcome.exit_code == 0, outcome.output
    assert "1/2 fig2" in outcome.stderr
    assert "2/2 fig4" in outcome.stderr
    assert json.loads(outcome.stdout) == json.loads((folder / "paper.json").read_text())
    return folder


def test_page_needs_nothing_else(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert set(re.findall(r'(?:src|href)="(.*?)"', page)) == {"data:,", "#fig2", "#fig4"}
    assert not re.search(r"https?://|url\(|@import", page)
    assert re.findall(r'<figure id="(.*?)"', page) == ["fig2-curves", "fig4-time", "fig4-space"]
    assert {file.name for file in folder.iterdir()} == {"report.html", "paper.json"}


def test_numbers_hold_what_was_asked_for(folder: Path) -> None:
    numbers = json.loads((folder / "paper.json").read_text())
    assert set(numbers) == {"fig2", "fig4"}
    assert all(value < 1e-3 for value in numbers["fig4"]["final_m_per_s"].values())
    assert all(abs(end) < 1.0 for pairs in numbers["fig4"]["ranges_m_per_s"].values() for pair in pairs for end in pair)


def test_texts_are_escaped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = Section("a < b", "p & q", "<i>", ["1 < 2"], [Table("<t>", ["<h>"], [["<r>", "<c>"]])])
    monkeypatch.setitem(ITEMS, "fig2", lambda _: section)
    write_paper(["fig2"], ROBOT, tmp_path, "omnibot paper --out 'a<b'", lambda _: None)
    page = (tmp_path / "report.html").read_text()
    assert "a &lt; b" in page
    for text in ("<i>", "<t>", "<h>", "<r>", "<c>", "a<b"):
        assert text not in page


# ---- what a user does wrong


def test_items_come_in_the_order_of_the_paper_and_once() -> None:
    assert choose("table1, fig2,fig2") == ["fig2", "table1"]
    assert choose(None) == ["fig2", "fig3a", "fig3b", "fig4", "fig5", "table1"]


@pytest.mark.parametrize("only", ["fig7", "fig2,table2", "", "fig2,"])
def test_unknown_item_is_refused_with_the_names(only: str, tmp_path: Path) -> None:
    outcome = CliRunner().invoke(app, ["paper", "--only", only, "--out", str(tmp_path / "new")])
    assert isinstance(outcome.exception, OmnibotError)
    assert "fig2, fig3a, fig3b, fig4, fig5, table1" in str(outcome.exception)
    assert "\n" not in str(outcome.exception)
    assert not (tmp_path / "new").exists()


def test_unwritable_folder_is_refused_before_anything_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(Simulator, "run", lambda *_: pytest.fail("something ran"))
    outcome = CliRunner().invoke(app, ["paper", "--only", "table1", "--out", str(tmp_path / "file" / "below")])
    assert isinstance(outcome.exception, OmnibotError)
    assert "--out" in str(outcome.exception)
