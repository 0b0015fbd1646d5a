"""The report of a run as data: what is drawn, what is left out and said, what the page holds."""

import base64
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.report import write_report
from host_sim.report.compare import names_of
from host_sim.report.figure import ACTUAL, Axis, Panel, level, line, numbers, thinned, upright
from host_sim.report.path import corners, distance_to_polyline, outline, path_figure, shown
from host_sim.report.run import figures, slip_panel, title_of
from host_sim.robot import load_robot
from host_sim.trace import Trace

ROBOT = load_robot()
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
RESULT = {
    "status": "completed",
    "scenario": {
        "path": "rhombus",
        "speed_m_per_s": 0.5,
        "parameters": {"force_bound_N": "2.5"},
        "command": "omnibot run --path rhombus --out 'my runs'",
    },
    "tracking": {"max_error_m": 0.00123456, "rms_error_m": None},
    "timing": {"steps": 1000, "step_time_us": {"mean": 1.5}},
}


def make_trace(rows: int = 1500) -> Trace:
    """A robot that follows two sides of the square at 1 m/s, 1 mm beside it, its wheels working a little."""
    time = np.arange(rows) * 1e-3
    reference = np.column_stack([np.minimum(time, 1.0), np.maximum(time - 1.0, 0.0)])
    point = reference + 1e-3
    waves = np.column_stack([np.sin(5.0 * time + phase) for phase in (0.0, 2.0, 4.0)])
    pose = np.column_stack([point - [0.0, ROBOT.tracked_point_offset_m], 0.0 * time])
    return Trace(
        tick=np.arange(rows, dtype=np.int64),
        time_s=time,
        pose=pose,
        body_twist=0.0 * waves,
        wheel_speed=0.0 * waves,
        slip_ratio=0.05 * waves,
        wheel_force=2.0 * waves,
        torque=0.1 * waves,
        point=point,
        reference_point=reference,
        reference_heading=0.01 * np.sin(time),
        mu=0.0 * waves,
        step_time_us=0.0 * time,
    )


def spoil(trace: Trace, first: int, value: float) -> Trace:
    """Replace every measured number from a row on."""
    columns = ("pose", "point", "slip_ratio", "wheel_force", "torque")
    spoilt = {name: trace.column(name).copy() for name in columns}
    for array in spoilt.values():
        array[first:] = value
    return replace(trace, **spoilt)


def unpacked(packed: dict[str, str]) -> np.ndarray:
    """The numbers that the drawing library is given."""
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype={"f4": "<f4"}[packed["dtype"]])


def panels_of(trace: Trace, polyline: np.ndarray = SQUARE, result: dict[str, Any] = RESULT) -> dict[str, Panel]:
    """Every panel of a run's page by the first word of its title."""
    return {p.title.split()[0]: p for figure in figures(trace, polyline, ROBOT, result) for p in figure.panels}


def view_of(panel: Panel) -> tuple[float, float]:
    assert panel.y.view is not None
    return panel.y.view


class Page(HTMLParser):
    """What a browser would make of the page: its tags, their attributes, the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._hidden = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._hidden = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._hidden = self._hidden and tag not in ("script", "style")

    def handle_data(self, data: str) -> None:
        self.text += "" if self._hidden else data

    def attributes(self, name: str) -> list[str]:
        return [str(attributes[name]) for _, attributes in self.tags if name in attributes]


def read_page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


# Figures ------------------------------------------------------------------------------------------------------------


def test_every_quantity_has_its_panel_with_title_and_unit() -> None:
    titles = [panel.title for panel in panels_of(make_trace()).values()]

    assert titles == [
        "Path from above (m)",
        "The first corner, enlarged (cm from 1.000 m, 0.000 m)",
        "Tracking error (mm)",
        "Heading error (mrad)",
        "Slip ratio (1)",
        "Force of the floor on each wheel (N)",
        "Torque of each motor (N·m)",
    ]


@pytest.mark.parametrize(("name", "column"), [("Slip", "slip_ratio"), ("Force", "wheel_force"), ("Torque", "torque")])
def test_wheel_panels_draw_the_three_wheels_of_the_trace(name: str, column: str) -> None:
    trace = make_trace()

    drawn = panels_of(trace)[name].traces

    assert [curve["name"] for curve in drawn] == ["wheel 1", "wheel 2", "wheel 3"]
    assert len({curve["line"]["color"] for curve in drawn}) == 3
    assert len({curve["line"]["dash"] for curve in drawn}) == 3  # told apart without colour
    for wheel, curve in enumerate(drawn):
        np.testing.assert_allclose(unpacked(curve["x"]), trace.time_s, rtol=1e-6)
        np.testing.assert_allclose(unpacked(curve["y"]), trace.column(column)[:, wheel], rtol=1e-6)


def test_limits_are_those_of_the_robot_and_of_what_the_firmware_was_told() -> None:
    panels = panels_of(make_trace())

    def levels(name: str) -> list[tuple[float, str]]:
        return [(shape["y0"], shape["label_text"]) for shape in panels[name].shapes if shape["y0"] > 0.0]

    assert levels("Force") == [
        (ROBOT.friction_limit_N, "friction limit 5 N"),
        (2.5, "firmware's bound 2.5 N"),
    ]
    assert levels("Torque") == [(ROBOT.torque_limit_Nm, "limit, firmware's bound 0.2 N·m")]
    (shade,) = panels["Slip"].shapes
    assert (shade["y0"], shade["y1"]) == (-0.1, 0.1)


@pytest.mark.parametrize(
    ("value", "first"),
    [(np.nan, 0), (np.nan, 1), (np.nan, 800), (np.inf, 800), (-np.inf, 0), (1e300, 0), (1e300, 800), (-3.0, 800)],
)
def test_diverged_run_is_drawn_and_says_what_is_missing(value: float, first: int) -> None:
    panels = panels_of(spoil(make_trace(), first, value))

    assert panels["Path"].note == f"not shown: {1500 - first} of 1500 positions, lost or not finite"
    assert "not shown" in panels["Tracking"].note
    for panel in panels.values():
        assert panel.y.view is None or np.isfinite(panel.y.view).all()
        json.dumps(panel.as_dict(), allow_nan=False)
        for trace in panel.traces:
            assert not np.isinf(unpacked(trace["y"])).any()


def test_diverged_run_keeps_the_axis_readable() -> None:
    panels = panels_of(spoil(make_trace(), 800, 1e6))

    assert view_of(panels["Tracking"]) == (0.0, 3.0)
    assert view_of(panels["Force"]) == (-20.0, 20.0)
    assert view_of(panels["Torque"]) == pytest.approx((-0.8, 0.8))
    assert view_of(panels["Magnitude"]) == (1e-4, 100.0)


def test_spinning_wheel_makes_the_axis_of_slip_logarithmic() -> None:
    trace = make_trace()

    assert not slip_panel(trace).y.log
    assert slip_panel(replace(trace, slip_ratio=40.0 * trace.slip_ratio)).y.log


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_run_of_few_rows_is_drawn(rows: int, tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(rows), {}, SQUARE)

    assert ("nothing was recorded" in read_page(tmp_path).text) == (rows == 0)


@pytest.mark.parametrize("points", [0, 1, 2])
def test_path_of_few_points_is_drawn(points: int) -> None:
    assert len(path_figure(make_trace(), SQUARE[:points], ROBOT).panels) == 1


# Numbers of a line --------------------------------------------------------------------------------------------------


def noise(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """A line that rests, jumps for a moment, and rests, with noise on it."""
    random = np.random.default_rng(7)
    x = np.arange(rows) * 1e-3
    burst = np.where(np.abs(x - 0.4 * x[-1]) < 0.05, 40.0 * np.sin(300.0 * x), 0.0)
    return x, burst + 0.05 * random.standard_normal(rows)


@pytest.mark.parametrize("rows", [10, 3000, 3001, 36_000, 500_000])
def test_thinned_line_is_short_and_loses_no_extreme(rows: int) -> None:
    x, y = noise(rows)

    kept = thinned(x, y, 3000)

    assert len(kept) <= min(rows, 3000)
    assert np.all(np.diff(kept) > 0)
    assert {0, rows - 1, int(y.argmin()), int(y.argmax())} <= set(kept.tolist())
    edges = np.unique(np.linspace(0, rows, 101).astype(int))
    for begin, end in itertools.pairwise(edges):  # nor the lowest and highest of any hundredth
        near = y[kept[(kept >= begin - rows // 100) & (kept < end + rows // 100)]]
        assert near.max() >= y[begin:end].max()
        assert near.min() <= y[begin:end].min()


def test_thinned_line_is_densest_where_it_moves() -> None:
    x, y = noise(36_000)

    kept = x[thinned(x, y, 3000)]

    assert np.count_nonzero(np.abs(kept - 0.4 * x[-1]) < 0.05) > 50  # of 36 000 rows, 100 lie there


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_thinned_line_keeps_its_gaps(value: float) -> None:
    x, y = noise(36_000)
    y[10_000:10_010] = value

    kept = thinned(x, y, 3000)

    drawn = unpacked(numbers(y[kept]))
    assert np.isnan(drawn).any()
    assert np.isfinite(drawn).sum() > 2000
    assert {9_999, 10_010} <= set(kept.tolist())


def test_line_of_one_value_is_thinned() -> None:
    x = np.arange(36_000.0)

    assert 2 <= len(thinned(x, np.ones_like(x), 3000)) <= 3000
    assert 2 <= len(thinned(x, np.full_like(x, np.nan), 3000)) <= 3000


def test_rows_left_out_are_gaps() -> None:
    kept = np.array([True, True, False, True])

    (seen,) = shown(kept, np.arange(4.0))

    np.testing.assert_array_equal(seen, [0.0, 1.0, np.nan, 3.0])


@pytest.mark.parametrize("log", [False, True])
def test_names_of_levels_stand_at_their_levels(log: bool) -> None:
    axis = Axis(log=log)
    panel = Panel("t", [], axis, axis, [level(100.0, "across"), upright(1000.0, "up")])

    across, up = panel.as_dict()["layout"]["annotations"]

    # Words are placed by logarithms on a logarithmic axis, lines by values: plotly.js, layout.annotations[].x
    assert (across["y"], up["x"]) == ((2.0, 3.0) if log else (100.0, 1000.0))
    assert [shape["y0"] for shape in panel.as_dict()["layout"]["shapes"]] == [100.0, 0]


def test_cursor_tells_name_value_and_unit() -> None:
    panel = Panel("t", [line([0.0], [1.0], "wheel 1", ACTUAL)], y=Axis(unit="N"))

    (trace,) = panel.as_dict()["data"]

    assert trace["hovertemplate"] == "wheel 1: %{y:.4g} N<extra></extra>"


# Units and corners --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error_m", "unit"), [(1e-5, "µm"), (1e-3, "mm"), (0.1, "cm"), (1.0, "m"), (0.0, "m")])
def test_error_is_shown_in_a_readable_unit(error_m: float, unit: str) -> None:
    trace = make_trace()
    trace = replace(trace, point=trace.reference_point + np.array([error_m, 0.0]))

    panel = panels_of(trace)["Tracking"]

    assert panel.title == f"Tracking error ({unit})"
    scale = {"µm": 1e6, "mm": 1e3, "cm": 1e2, "m": 1.0}[unit]
    np.testing.assert_allclose(unpacked(panel.traces[0]["y"]), error_m * scale, rtol=1e-6)


@pytest.mark.parametrize("points_a_side", [2, 3, 50, 500])
def test_corners_of_a_square_are_found(points_a_side: int) -> None:
    sides = [np.linspace(a, b, points_a_side) for a, b in itertools.pairwise(SQUARE)]

    np.testing.assert_allclose(corners(np.concatenate(sides)), SQUARE[1:3], atol=1e-6)


def test_rounded_corner_is_found_in_its_middle() -> None:
    turn = np.linspace(-np.pi / 2, 0.0, 40)
    arc = np.column_stack([0.97 + 0.03 * np.cos(turn), 0.03 + 0.03 * np.sin(turn)])
    path = np.concatenate([[[0.0, 0.0]], arc, [[1.0, 1.0]]])

    (corner,) = corners(path)

    np.testing.assert_allclose(corner, [0.97 + 0.03 * np.sqrt(0.5), 0.03 - 0.03 * np.sqrt(0.5)], atol=1e-3)


def test_smooth_paths_and_lines_have_no_corner() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 500)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    lemniscate = (np.cos(angle) / (1 + np.sin(angle) ** 2))[:, np.newaxis] * np.column_stack(
        [angle * 0 + 1, np.sin(angle)]
    )

    for path in (circle, lemniscate, SQUARE[:2], SQUARE[:1], np.zeros((0, 2)), np.zeros((5, 2))):
        assert corners(path) == []


def test_path_figure_enlarges_a_corner_only_if_it_was_driven() -> None:
    assert len(path_figure(make_trace(1500), SQUARE, ROBOT).panels) == 2
    assert len(path_figure(make_trace(500), SQUARE, ROBOT).panels) == 1


def test_distance_to_polyline_beside_and_beyond_a_segment() -> None:
    points = np.array([[0.5, -0.3], [-3.0, -4.0], [0.9, 0.5], [1.0, 1.0]])

    np.testing.assert_allclose(distance_to_polyline(points, SQUARE), [0.3, 5.0, 0.1, 0.0], atol=1e-15)


def pieces(panel: Panel, name: str) -> list[list[np.ndarray]]:
    """The lines of that name, cut at their gaps: for each trace, its pieces of shape (k, 2)."""
    found = []
    for trace in panel.traces:
        if trace["name"] == name and trace["mode"] == "lines":
            xy = np.column_stack([unpacked(trace["x"]), unpacked(trace["y"])])
            cuts = np.flatnonzero(np.isnan(xy[:, 0]))
            parts = [part[~np.isnan(part[:, 0])] for part in np.split(xy, cuts)]
            found.append([part for part in parts if len(part)])
    return found


def test_robot_is_drawn_to_scale_with_three_wheels_and_its_point_on_the_path() -> None:
    panel = path_figure(make_trace(), SQUARE, ROBOT).panels[0]

    bodies, wheels, arms = pieces(panel, "robot at instants")

    assert len(bodies) >= 2
    assert (len(wheels), len(arms)) == (3 * len(bodies), len(bodies))
    for body, arm in zip(bodies, arms, strict=True):
        np.testing.assert_allclose(np.linalg.norm(body - arm[0], axis=1), ROBOT.wheel_distance_m, rtol=1e-5)
    for wheel in wheels:
        assert np.linalg.norm(wheel[1] - wheel[0]) == pytest.approx(2.0 * ROBOT.wheel_radius_m, rel=1e-4)
    assert distance_to_polyline(np.array([arm[1] for arm in arms], dtype=float), SQUARE).max() < 2e-3


def test_wheels_stand_at_120_degrees_and_roll_along_the_rim() -> None:
    wheels = outline(ROBOT)["wheels"].reshape(3, 3, 2)[:, :2]

    hubs, axles = wheels.mean(axis=1), wheels[:, 1] - wheels[:, 0]

    np.testing.assert_allclose(np.linalg.norm(hubs, axis=1), ROBOT.wheel_distance_m)
    cosines = [hubs[a] @ hubs[b] / ROBOT.wheel_distance_m**2 for a, b in ((0, 1), (1, 2), (2, 0))]
    np.testing.assert_allclose(cosines, -0.5, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ij,ij->i", hubs, axles), 0.0, atol=1e-12)


# Page ---------------------------------------------------------------------------------------------------------------


def test_report_is_one_file_and_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        assert write_report(tmp_path / folder, make_trace(), RESULT, SQUARE) == tmp_path / folder / "report.html"
        assert [file.name for file in (tmp_path / folder).iterdir()] == ["report.html"]

    assert (tmp_path / "a" / "report.html").read_bytes() == (tmp_path / "b" / "report.html").read_bytes()


def test_page_stays_small_however_long_the_run(tmp_path: Path) -> None:
    sizes = []
    for rows in (3_000, 60_000):
        write_report(tmp_path, make_trace(rows), RESULT, SQUARE)
        sizes.append((tmp_path / "report.html").stat().st_size)

    assert max(sizes) < 3_000_000
    assert sizes[1] - sizes[0] < 300_000


def test_page_refers_to_nothing_else(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(), RESULT, SQUARE)
    page, text = read_page(tmp_path), (tmp_path / "report.html").read_text(encoding="utf-8")

    assert page.attributes("src") == []
    assert page.attributes("href") == ["data:,"]
    assert not re.search(r"https?://|@import|url\(", text)


def test_page_names_every_figure_and_fits_a_phone(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(10), RESULT, SQUARE)
    page = read_page(tmp_path)

    plots = [attributes for _, attributes in page.tags if attributes.get("role") == "img"]
    assert len(plots) == 6
    assert all(len(str(attributes["aria-label"])) > 40 for attributes in plots)
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in page.tags


def test_page_shows_results_scenario_and_command(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(10), RESULT, SQUARE)
    page = read_page(tmp_path)

    assert "omnibot run --path rhombus --out 'my runs'" in page.text
    for text in ("completed", "1.235 mm", "0.001235", "step_time_us.mean", "force_bound_N", "rms_error_m"):
        assert text in page.text
    assert "nan" not in page.text.lower()


def test_page_escapes_what_it_is_given(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>\"'&"
    scenario = {"path": evil, evil: evil, "command": f"omnibot {evil}"}
    write_report(tmp_path, make_trace(10), {"status": evil, "scenario": scenario, evil: {evil: [evil]}}, SQUARE)
    page = read_page(tmp_path)

    assert "<script>alert" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.text.count(evil) >= 7
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_page_quotes_a_command_given_as_words(tmp_path: Path) -> None:
    command = ["omnibot", "run", "--out", "my runs"]
    write_report(tmp_path, make_trace(10), {"scenario": {"command": command}}, SQUARE)

    assert "omnibot run --out 'my runs'" in read_page(tmp_path).text


@pytest.mark.parametrize(
    ("scenario", "title"),
    [
        ({}, "Run"),
        ({"path": "circle", "speed_m_per_s": 0.25, "order": "2"}, "Circle path at 0.25 m/s with order 2"),
        ({"path": "rhombus", "order": "observer"}, "Rhombus path with the observer"),
    ],
)
def test_title_names_the_run(scenario: dict[str, Any], title: str) -> None:
    assert title_of(scenario) == title


def test_report_below_a_regular_file_names_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    with pytest.raises(OmnibotError, match="choose another folder"):
        write_report(tmp_path / "file" / "run", make_trace(10), RESULT, SQUARE)


@pytest.mark.parametrize(
    ("folders", "names"),
    [
        (["runs/a", "runs/b"], ["a", "b"]),
        (["x/run", "y/run"], ["x/run", "y/run"]),
        (["run", "run"], ["run (1)", "run (2)"]),
    ],
)
def test_runs_get_the_shortest_names_that_differ(folders: Sequence[str], names: list[str]) -> None:
    assert names_of([Path(folder) for folder in folders]) == names
