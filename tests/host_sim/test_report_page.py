"""The pages in a browser: Chromium opens them as a person would, on a desk, on a phone, in the dark and on paper."""

import io
import json
import re
from pathlib import Path
from typing import Any, Self

import pytest
from playwright.sync_api import Browser, Page
from pypdf import PdfReader
from typer.testing import CliRunner

from host_sim.cli import app
from host_sim.errors import OmnibotError

SHORT = ["--speed", "0.5", "--start-before-corner", "0.5", "--duration", "1.2"]
DESK, PHONE = {"width": 1280, "height": 900}, {"width": 360, "height": 740}
UNITS = {"µm": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "µrad": 1e-6, "mrad": 1e-3, "rad": 1.0, "%": 1e-2}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs of two orders, the first twice, a plan, a step, the paper's quickest items, and a comparison."""
    folder = tmp_path_factory.mktemp("pages")
    for name, order in (("order 0", "0"), ("again", "0"), ("observer", "observer")):
        assert omnibot("run", *SHORT, "--order", order, "--out", str(folder / name)) == 0
    assert omnibot("plan", "--path", "square", "--speed", "0.8", "--out", str(folder / "plan")) == 0
    assert omnibot("step", "--duration", "0.5", "--out", str(folder / "step")) == 0
    assert omnibot("paper", "--only", "fig2,fig4", "--out", str(folder / "paper")) == 0
    compared = [str(folder / name) for name in ("order 0", "again", "observer")]
    with pytest.raises(OmnibotError, match="order 0 and observer differ in"):
        omnibot("compare", *compared, "--out", str(folder / "compare"))
    return {name: folder / name for name in ("observer", "plan", "step", "paper", "compare")}


def omnibot(*arguments: str) -> int:
    outcome = CliRunner().invoke(app, list(arguments))
    if isinstance(outcome.exception, OmnibotError):
        raise outcome.exception
    return outcome.exit_code


class Seen:
    """A page as it was opened: what it asked the network for, what it complained of."""

    def __init__(self, browser: Browser, folder: Path, size: dict[str, int], **more: Any) -> None:
        self._context = browser.new_context(viewport=size, **more)  # type: ignore[arg-type]
        self.page: Page = self._context.new_page()
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto((folder / "report.html").as_uri())
        self.page.wait_for_selector("html[data-drawn]", state="attached", timeout=60_000)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.close()


def drawn_sizes(page: Page) -> list[tuple[float, float, float]]:
    """Of each panel: width and height between its axes, and the extent of what is drawn there, in pixels."""
    sizes: list[tuple[float, float, float]] = page.evaluate(
        """() => [...document.querySelectorAll('.plot')].map((plot) => {
            const area = plot.querySelector('.nsewdrag').getBoundingClientRect();
            const boxes = [...plot.querySelectorAll('.trace path')].map((path) => path.getBoundingClientRect());
            return [area.width, area.height, Math.max(...boxes.map((box) => box.width + box.height))];
        })"""
    )
    return sizes


@pytest.mark.parametrize("name", ["observer", "plan", "step", "paper", "compare"])
@pytest.mark.parametrize(
    ("size", "more"),
    [(DESK, {}), (PHONE, {"has_touch": True, "is_mobile": True}), (DESK, {"color_scheme": "dark"})],
    ids=["desk", "phone", "dark"],
)
def test_page_draws_every_figure_asks_for_nothing_and_fits(
    browser: Browser, runs: dict[str, Path], name: str, size: dict[str, int], more: dict[str, Any]
) -> None:
    with Seen(browser, runs[name], size, **more) as seen:
        sizes = drawn_sizes(seen.page)
        assert len(sizes) >= {"plan": 2, "step": 4}.get(name, 6)
        assert all(width > 200 and height > 100 and extent > 50 for width, height, extent in sizes), sizes
        assert seen.complaints == []
        # The blob is the drawing library, unpacked from the page itself.
        assert [url for url in seen.requests if not url.startswith(("file:", "data:", "blob:"))] == []
        assert sum(url.startswith("file:") for url in seen.requests) == 1
        width = seen.page.evaluate("document.documentElement.scrollWidth")
        assert width <= size["width"]


def contrast(page: Page, foreground: str, background: str) -> float:
    """The contrast of two colours of the style sheet, as the web accessibility guidelines (WCAG 2.1) define it."""
    values = page.evaluate(
        """(names) => names.map((name) => {
            const probe = document.createElement('i');
            probe.style.color = `var(${name})`;
            document.body.append(probe);
            return getComputedStyle(probe).color.match(/[\\d.]+/g).slice(0, 3).map(Number);
        })""",
        [foreground, background],
    )
    light = [sum(w * channel(c) for w, c in zip((0.2126, 0.7152, 0.0722), rgb, strict=True)) for rgb in values]
    return (max(light) + 0.05) / (min(light) + 0.05)


def channel(value: float) -> float:
    share = value / 255.0
    return share / 12.92 if share <= 0.03928 else float(((share + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_and_lines_can_be_read(browser: Browser, runs: dict[str, Path], scheme: str) -> None:
    with Seen(browser, runs["observer"], DESK, color_scheme=scheme) as seen:
        for word in ("--ink", "--muted", "--accent"):
            assert contrast(seen.page, word, "--card") >= 4.5, word
        for line in ("--blue", "--vermilion", "--green", "--purple", "--orange", "--sky", "--limit"):
            assert contrast(seen.page, line, "--card") >= 3.0, line


def test_numbers_shown_are_those_of_the_result(browser: Browser, runs: dict[str, Path]) -> None:
    result = json.loads((runs["observer"] / "result.json").read_text())
    with Seen(browser, runs["observer"], DESK) as seen:
        shown = seen.page.evaluate(
            """Object.fromEntries([...document.querySelectorAll('[data-key]')].map(
                (tile) => [tile.dataset.key, tile.textContent]))"""
        )
        text = seen.page.inner_text("body")
    assert len(shown) == 8
    for key, told in shown.items():
        expected: Any = result
        for part in key.split("."):
            expected = expected[part]
        number, _, unit = told.partition(" ")
        assert float(number) * UNITS.get(unit, 1.0) == pytest.approx(expected, rel=1e-3), key
    assert result["scenario"]["command"] in text
    assert result["status"] in text


def test_panels_hold_the_extremes_of_the_result(browser: Browser, runs: dict[str, Path]) -> None:
    result = json.loads((runs["observer"] / "result.json").read_text())
    with Seen(browser, runs["observer"], DESK) as seen:
        drawn = seen.page.evaluate(
            """() => Object.fromEntries([...document.querySelectorAll('.panel')].map((panel) => {
                const heights = panel.querySelector('.plot').calcdata.flat().map((point) => Math.abs(point.y));
                return [panel.querySelector('h3').textContent, Math.max(...heights.filter(isFinite))];
            }))"""
        )
    error = next(title for title in drawn if title.startswith("Tracking error"))
    unit = re.search(r"\((.*)\)", error)
    assert unit is not None
    assert drawn[error] * UNITS[unit[1]] == pytest.approx(result["tracking"]["max_error_m"], rel=1e-5)
    assert drawn["Slip ratio (1)"] == pytest.approx(result["slip"]["max_ratio"], rel=1e-5)
    assert drawn["Torque of each motor (N·m)"] == pytest.approx(result["torque"]["max_Nm"], rel=1e-5)


def test_name_in_a_legend_hides_its_lines_and_shows_them_again(browser: Browser, runs: dict[str, Path]) -> None:
    def lines() -> int:
        return seen.page.locator("#wheels .scatterlayer .trace").count()

    with Seen(browser, runs["observer"], DESK) as seen:
        button = seen.page.get_by_role("button", name="wheel 2")
        before = lines()
        button.click()
        assert button.get_attribute("aria-pressed") == "false"
        seen.page.wait_for_function("document.querySelectorAll('#wheels .scatterlayer .trace').length === 6")
        button.click()
        seen.page.wait_for_function("document.querySelectorAll('#wheels .scatterlayer .trace').length === 9")
        assert before == 9
        assert seen.complaints == []


def test_enlarging_one_panel_over_time_enlarges_the_others(browser: Browser, runs: dict[str, Path]) -> None:
    with Seen(browser, runs["observer"], DESK) as seen:
        area = seen.page.locator("#error .plot .nsewdrag").first
        area.scroll_into_view_if_needed()
        box = area.bounding_box()
        assert box is not None
        seen.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 60)
        seen.page.mouse.down()
        seen.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 62, steps=5)
        seen.page.mouse.up()
        seen.page.wait_for_function("document.querySelector('#wheels .plot').layout.xaxis.range[0] > 0.1")
        views = seen.page.evaluate(
            "[...document.querySelectorAll('#error .plot, #wheels .plot')].map((plot) => plot.layout.xaxis.range)"
        )
        assert len(views) == 5
        for view in views:
            assert view == pytest.approx([0.3, 0.6], abs=0.02)
        assert seen.complaints == []


def test_robot_follows_the_slider_and_the_cursor(browser: Browser, runs: dict[str, Path]) -> None:
    def centre() -> list[float]:
        place: list[float] = seen.page.evaluate(
            """() => { const arm = document.querySelector('#path .plot').data.filter((t) => t.meta === 'film').at(-1);
                       return [arm.x[0], arm.y[0]]; }"""
        )
        return place

    with Seen(browser, runs["observer"], DESK) as seen:
        start = centre()
        slider = seen.page.locator(".film input")
        slider.evaluate("(input) => { input.value = input.max; input.dispatchEvent(new Event('input')); }")
        assert seen.page.locator(".film output").text_content() == "1.20 s"
        end = centre()
        # 1.2 s at 0.5 m/s around a right angle in the middle: 0.6 m of path, over 0.3 m and under 0.6 m apart
        assert 0.3 < ((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2) ** 0.5 < 0.6
        area = seen.page.locator("#wheels .plot .nsewdrag").first
        area.hover(position={"x": 5, "y": 60})
        seen.page.wait_for_function("parseFloat(document.querySelector('.film output').textContent) < 0.2")
        assert seen.complaints == []


def test_paper_carries_the_figures_in_light_colours(browser: Browser, runs: dict[str, Path]) -> None:
    with Seen(browser, runs["observer"], DESK, color_scheme="dark") as seen:
        document = PdfReader(io.BytesIO(seen.page.pdf(format="A4")))
        text = "".join(page.extract_text() for page in document.pages)
        assert len(document.pages) <= 4
        assert text.count("time (s)") == 5  # below each of the panels over time
        for words in ("x1 (m)", "friction limit 5 N", "To repeat it", "wheel 3"):
            assert words in text
        # The page is drawn for the screen again.
        seen.page.wait_for_function("!document.documentElement.classList.contains('paper')")
        assert seen.complaints == []


def test_comparison_tells_what_is_the_same_and_what_is_not(browser: Browser, runs: dict[str, Path]) -> None:
    with Seen(browser, runs["compare"], DESK) as seen:
        text = seen.page.inner_text("body")
    assert re.search(r"again\s+identical in every array", text)
    assert re.search(r"observer\s+pose: \d+ of \d+ rows differ", text)
    assert re.search(r"order\s+0\s+0\s+observer\n", text)
    assert "speed_m_per_s" not in text  # the same in all of them


def test_page_without_scripts_still_tells_the_numbers(browser: Browser, runs: dict[str, Path]) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((runs["observer"] / "report.html").as_uri())
    text = page.inner_text("body")
    context.close()
    assert "The figures need a browser that runs scripts." in text
    assert "Largest tracking error" in text
