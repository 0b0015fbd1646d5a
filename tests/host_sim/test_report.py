"""The report of a run: figures that show something, a page that needs nothing else."""

import base64
import io
import itertools
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import image

from host_sim.errors import OmnibotError
from host_sim.report import STYLE, _corners, _distance_to_polyline, draw_figures, write_report
from host_sim.robot import load_robot
from host_sim.trace import Trace

FIGURES = ("path", "error", "slip", "force", "torque")
ROBOT = load_robot()
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
RESULT = {
    "status": "completed",
    "scenario": {
        "path": "rhombus",
        "speed_m_per_s": 0.5,
        "parameters": {"order": 1},
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


def inked(picture: np.ndarray) -> float:
    """The share of the picture that is not white."""
    return float(np.mean(picture[..., :3].min(axis=-1) < 0.8))


def colour_share(picture: np.ndarray, colour: str) -> float:
    wanted = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return float(np.mean(np.abs(picture[..., :3] - wanted).max(axis=-1) < 0.05))


class Page(HTMLParser):
    """What a browser would make of the page: its tags, their attributes, the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def attributes(self, name: str) -> list[str]:
        return [str(attributes[name]) for _, attributes in self.tags if name in attributes]


def read_page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


# Figures ------------------------------------------------------------------------------------------------------------


def test_report_writes_every_figure_with_something_in_it(tmp_path: Path) -> None:
    page = write_report(tmp_path / "run", make_trace(), RESULT, SQUARE)

    assert page == tmp_path / "run" / "report.html"
    assert sorted(p.name for p in page.parent.iterdir()) == sorted([*(f"{n}.png" for n in FIGURES), "report.html"])
    for name in FIGURES:
        picture = image.imread(page.parent / f"{name}.png")
        assert 0.01 < inked(picture) < 0.3, name
        assert colour_share(picture, "#0072B2") > 5e-4, name


@pytest.mark.parametrize("name", ["slip", "force", "torque"])
def test_wheel_figures_show_three_wheels(name: str, tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(), RESULT, SQUARE)

    picture = image.imread(tmp_path / f"{name}.png")

    for colour in ("#0072B2", "#D55E00", "#009E73"):
        assert colour_share(picture, colour) > 5e-4


def test_figures_of_the_same_run_are_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_report(tmp_path / folder, make_trace(), RESULT, SQUARE)

    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


@pytest.mark.parametrize(
    ("value", "first"),
    [(np.nan, 0), (np.nan, 1), (np.nan, 800), (np.inf, 800), (-np.inf, 0), (1e300, 0), (1e300, 800), (-3.0, 800)],
)
def test_diverged_run_is_drawn_and_says_what_is_missing(value: float, first: int) -> None:
    trace = spoil(make_trace(), first, value)

    figures = draw_figures(trace, SQUARE, ROBOT)

    hidden = {name: figure.axes[0].get_title(loc="left") for name, figure in figures.items()}
    assert f"not shown: {1500 - first} of 1500 positions" in hidden["path"] or first == 0
    assert "not shown" in hidden["error"]
    for figure in figures.values():
        figure.savefig(io.BytesIO(), format="png", dpi=50)
        for axes in figure.axes:
            assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()


def test_diverged_run_keeps_the_axis_readable() -> None:
    figures = draw_figures(spoil(make_trace(), 800, 1e6), SQUARE, ROBOT)

    assert figures["error"].axes[0].get_ylim() == (0.0, 3.0)
    assert figures["force"].axes[0].get_ylim() == (-20.0, 20.0)
    assert figures["torque"].axes[0].get_ylim() == pytest.approx((-0.8, 0.8))
    assert figures["slip"].axes[0].get_ylim() == (-100.0, 100.0)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_run_of_few_rows_is_drawn(rows: int, tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(rows), {}, SQUARE)

    assert (tmp_path / "report.html").exists()


@pytest.mark.parametrize("points", [0, 1, 2])
def test_path_of_few_points_is_drawn(points: int) -> None:
    draw_figures(make_trace(), SQUARE[:points], ROBOT)["path"].savefig(io.BytesIO(), format="png")


def test_figures_leave_the_settings_of_the_drawing_library_alone(tmp_path: Path) -> None:
    before = {name: matplotlib.rcParams[name] for name in STYLE}

    write_report(tmp_path, make_trace(10), RESULT, SQUARE)

    assert {name: matplotlib.rcParams[name] for name in STYLE} == before
    assert before["axes.titlelocation"] != STYLE["axes.titlelocation"]


# Units and corners --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error_m", "unit"), [(1e-5, "µm"), (1e-3, "mm"), (0.1, "cm"), (1.0, "m"), (0.0, "m")])
def test_error_is_shown_in_a_readable_unit(error_m: float, unit: str) -> None:
    trace = make_trace()
    trace = replace(trace, point=trace.reference_point + np.array([error_m, 0.0]))

    axes = draw_figures(trace, SQUARE, ROBOT)["error"].axes[0]

    assert axes.get_title(loc="left") == f"Tracking error ({unit})"
    scale = {"µm": 1e6, "mm": 1e3, "cm": 1e2, "m": 1.0}[unit]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), error_m * scale, rtol=1e-9)


@pytest.mark.parametrize("points_a_side", [2, 3, 50, 500])
def test_corners_of_a_square_are_found(points_a_side: int) -> None:
    sides = [np.linspace(a, b, points_a_side) for a, b in itertools.pairwise(SQUARE)]

    corners = _corners(np.concatenate(sides))

    np.testing.assert_allclose(corners, SQUARE[1:3], atol=1e-6)


def test_rounded_corner_is_found_in_its_middle() -> None:
    turn = np.linspace(-np.pi / 2, 0.0, 40)
    arc = np.column_stack([0.97 + 0.03 * np.cos(turn), 0.03 + 0.03 * np.sin(turn)])
    path = np.concatenate([[[0.0, 0.0]], arc, [[1.0, 1.0]]])

    (corner,) = _corners(path)

    np.testing.assert_allclose(corner, [0.97 + 0.03 * np.sqrt(0.5), 0.03 - 0.03 * np.sqrt(0.5)], atol=1e-3)


def test_smooth_paths_and_lines_have_no_corner() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 500)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    lemniscate = (np.cos(angle) / (1 + np.sin(angle) ** 2))[:, np.newaxis] * np.column_stack(
        [angle * 0 + 1, np.sin(angle)]
    )

    for path in (circle, lemniscate, SQUARE[:2], SQUARE[:1], np.zeros((0, 2)), np.zeros((5, 2))):
        assert _corners(path) == []


def test_path_figure_enlarges_a_corner_only_if_it_was_driven() -> None:
    assert len(draw_figures(make_trace(1500), SQUARE, ROBOT)["path"].axes) == 2
    assert len(draw_figures(make_trace(500), SQUARE, ROBOT)["path"].axes) == 1


def test_distance_to_polyline_beside_and_beyond_a_segment() -> None:
    points = np.array([[0.5, -0.3], [-3.0, -4.0], [0.9, 0.5], [1.0, 1.0]])

    np.testing.assert_allclose(_distance_to_polyline(points, SQUARE), [0.3, 5.0, 0.1, 0.0], atol=1e-15)


def test_robot_is_drawn_to_scale_with_its_point_on_the_path() -> None:
    axes = draw_figures(make_trace(), SQUARE, ROBOT)["path"].axes[0]

    bodies = axes.patches
    assert len(bodies) >= 2
    assert all(body.radius == ROBOT.wheel_distance_m for body in bodies)
    dots = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "o"]
    assert len(dots) == len(bodies)
    assert _distance_to_polyline(np.array(dots), SQUARE).max() < 2e-3


# Page ---------------------------------------------------------------------------------------------------------------


def test_page_carries_its_figures_and_refers_to_nothing_else(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(), RESULT, SQUARE)
    page = read_page(tmp_path)

    sources = page.attributes("src")
    pictures = [base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True) for source in sources]
    assert pictures == [(tmp_path / f"{name}.png").read_bytes() for name in FIGURES]
    assert page.attributes("href") == []
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|//[a-z]|@import|url\(", re.sub(r'src="data:[^"]*"', "", text))
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}


def test_page_has_a_text_for_every_figure_and_fits_a_phone(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(10), RESULT, SQUARE)
    page = read_page(tmp_path)

    assert len(page.attributes("alt")) == len(FIGURES)
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in page.tags


def test_page_shows_results_scenario_and_command(tmp_path: Path) -> None:
    write_report(tmp_path, make_trace(10), RESULT, SQUARE)
    page = read_page(tmp_path)

    for shown in ("completed", "0.001235", "step_time_us.mean", "parameters.order", RESULT["scenario"]["command"]):
        assert shown in page.text
    assert "nan" not in page.text.lower()


def test_page_escapes_what_it_is_given(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>\"'&"
    scenario = {"path": evil, evil: evil, "command": f"omnibot {evil}"}
    write_report(tmp_path, make_trace(10), {"status": evil, "scenario": scenario, evil: {evil: [evil]}}, SQUARE)
    page = read_page(tmp_path)

    assert "<script" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.text.count(evil) >= 7
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_page_quotes_a_command_given_as_words(tmp_path: Path) -> None:
    command = ["omnibot", "run", "--out", "my runs"]
    write_report(tmp_path, make_trace(10), {"scenario": {"command": command}}, SQUARE)

    assert "omnibot run --out 'my runs'" in read_page(tmp_path).text


def test_report_below_a_regular_file_names_the_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    with pytest.raises(OmnibotError, match="choose another folder"):
        write_report(tmp_path / "file" / "run", make_trace(10), RESULT, SQUARE)
