"""Figures as data for plotly.js: panels of lines, points, bars and bands.

A colour is the name of a custom property of ``page.css``, such as ``--blue``: the page looks it up when it draws, so
that one figure serves light and dark screens and paper. A style differs from the others in its dashes as well.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from host_sim.robot import Array

Drawn = dict[str, Any]  # one trace, as plotly.js calls it
Shape = dict[str, Any]
Range = tuple[float, float]

POINTS = 3000  # of a line; twice as many as a screen is wide
OVERFLOW = 1e9  # numbers beyond are gaps


class Style(NamedTuple):
    """How a line looks."""

    colour: str
    dash: Literal["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"] = "solid"
    width_px: float = 1.5


# Blue, vermilion, green, ... of Okabe and Ito: told apart with any colour vision; by their dashes in black and white.
STYLES = (
    Style("--blue"),
    Style("--vermilion", "dash"),
    Style("--green", "dashdot"),
    Style("--purple", "dot", 2.0),
    Style("--orange", "longdash"),
    Style("--sky", "longdashdot"),
)
ACTUAL = STYLES[0]
REFERENCE = Style("--reference", width_px=6.0)
LIMIT = Style("--limit", "dot", 1.2)


@dataclass(frozen=True)
class Axis:
    """One axis of a panel.

    Attributes
    ----------
    title
        What it shows, with the unit in brackets.
    view
        Both ends of what is shown at first, in the axis' unit; without it, all there is.
    log
        Logarithmic?
    ticks
        Values that get a name of their own, instead of those that the drawing library chooses.
    unit
        Added to the value under the cursor.
    zero
        Begin at 0 where no view is given?
    """

    title: str = ""
    view: Range | None = None
    log: bool = False
    ticks: Mapping[float, str] | None = None
    unit: str = ""
    zero: bool = False

    def layout(self) -> dict[str, Any]:
        """Return the axis as plotly.js takes it."""
        layout: dict[str, Any] = {"title": {"text": self.title, "standoff": 8}, "type": "log" if self.log else "linear"}
        if self.view is not None:
            layout["range"] = [float(np.log10(end)) if self.log else float(end) for end in self.view]
        if self.zero and self.view is None:
            layout["rangemode"] = "tozero"
        if self.ticks is not None:
            layout |= {"tickmode": "array", "tickvals": list(self.ticks), "ticktext": list(self.ticks.values())}
        elif self.log:
            layout |= {"dtick": 1, "exponentformat": "power"}
        return layout | {"ticksuffix": "", "hoverformat": ".4g"}


@dataclass(frozen=True)
class Panel:
    """One pair of axes and what is drawn between them.

    Attributes
    ----------
    title
        What is shown, with the unit in brackets.
    traces
        What is drawn: see `line`, `points`, `bars`.
    x, y
        The axes.
    shapes
        What lies behind: see `band`, `level`, `upright`.
    note
        What is not shown, if anything.
    equal
        One scale along both axes?
    group
        Panels of the same group keep the same view along x.
    height_px
        Of the whole panel on a screen.
    extra
        What the page's script needs besides: see `Film`.
    """

    title: str
    traces: Sequence[Drawn]
    x: Axis = Axis()
    y: Axis = Axis()
    shapes: Sequence[Shape] = ()
    note: str = ""
    equal: bool = False
    group: str = ""
    height_px: int = 260
    extra: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return what ``page.js`` draws."""
        x, y = self.x.layout(), self.y.layout()
        if self.equal:
            y |= {"scaleanchor": "x", "scaleratio": 1}
        shapes = [{key: value for key, value in shape.items() if key != "label_text"} for shape in self.shapes]
        layout = {
            "xaxis": x,
            "yaxis": y,
            "shapes": shapes,
            "annotations": [self._label(shape) for shape in self.shapes if shape["label_text"]],
            "hovermode": "closest" if self.equal else "x unified",
        }
        traces = [self._with_hover(trace) for trace in self.traces]
        return {"data": traces, "layout": layout, "group": self.group, **self.extra}

    def _label(self, shape: Shape) -> dict[str, Any]:
        """Name a shape; where an axis is logarithmic, places of words are logarithms, unlike those of shapes."""
        label = {"text": shape["label_text"], "showarrow": False, "font": {"color": "--muted", "size": 12}}
        if shape.get("xref") == "paper":
            place = float(np.log10(shape["y1"])) if self.y.log else shape["y1"]
            return label | {"x": 1, "xref": "paper", "xanchor": "right", "y": place, "yanchor": "bottom"}
        place = float(np.log10(shape["x1"])) if self.x.log else shape["x1"]
        return label | {"x": place, "xanchor": "left", "y": 0.03, "yref": "paper", "yanchor": "bottom"}

    def _with_hover(self, trace: Drawn) -> Drawn:
        """Say what the cursor tells, where the trace does not say itself."""
        if "hovertemplate" in trace or trace.get("hoverinfo") == "skip":
            return trace
        value = "x" if trace.get("orientation") == "h" else "y"
        unit = self.x.unit if value == "x" else self.y.unit
        return {**trace, "hovertemplate": f"{trace['name']}: %{{{value}:.4g}} {unit}".rstrip() + "<extra></extra>"}


@dataclass(frozen=True)
class Figure:
    """Panels that belong together, with one legend and one caption; the name is that of its place on the page."""

    name: str
    caption: str
    panels: Sequence[Panel]
    wide: bool = False  # over the whole width of the page

    def legend(self) -> list[Drawn]:
        """Return the first trace of each name that has one."""
        found: dict[str, Drawn] = {}
        for panel in self.panels:
            for trace in panel.traces:
                if trace["name"]:
                    found.setdefault(trace["name"], trace)
        return list(found.values())


# What is drawn ------------------------------------------------------------------------------------------------------


def line(x: Array | Sequence[float], y: Array | Sequence[float], name: str, style: Style, **more: Any) -> Drawn:
    """Draw a line through points of shape (n,) each; what is not a number, or huge, is a gap in it."""
    trace: Drawn = {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": numbers(x),
        "y": numbers(y),
        "line": {"color": style.colour, "dash": style.dash, "width": style.width_px},
    }
    return trace | more


def curve(x: Array, y: Array, name: str, style: Style, **more: Any) -> Drawn:
    """Draw a line over rising x, both of shape (n,), by no more points than can be seen; every extreme is kept."""
    rows = thinned(x, y)
    return line(x[rows], y[rows], name, style, **more)


def points(x: Array | Sequence[float], y: Array | Sequence[float], name: str, style: Style, symbol: str) -> Drawn:
    """Draw markers, joined by a line unless its width is 0."""
    mode = "lines+markers" if style.width_px else "markers"
    return line(x, y, name, style, mode=mode, marker={"color": style.colour, "symbol": symbol, "size": 8})


def bars(x: Array | Sequence[float], y: Array | Sequence[float], name: str, colour: str, **more: Any) -> Drawn:
    """Draw a bar for each pair."""
    return {"type": "bar", "name": name, "x": numbers(x), "y": numbers(y), "marker": {"color": colour}} | more


def band(low: float, high: float, text: str = "", along: Literal["x", "y"] = "y") -> Shape:
    """Shade what lies between two values of an axis."""
    other = "x" if along == "y" else "y"
    ends = {f"{along}0": low, f"{along}1": high, f"{other}0": 0, f"{other}1": 1, f"{other}ref": "paper"}
    return {"type": "rect", **ends, "fillcolor": "--shade", "line": {"width": 0}, "layer": "below", "label_text": text}


def level(value: float, text: str = "", style: Style = LIMIT) -> Shape:
    """Draw a horizontal line over the whole width, and its name above its right end."""
    return {
        "type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": value, "y1": value, "label_text": text,
        "line": {"color": style.colour, "dash": style.dash, "width": style.width_px},
    }  # fmt: skip


def upright(value: float, text: str = "", style: Style = LIMIT) -> Shape:
    """Draw a vertical line over the whole height, and its name beside its foot."""
    return {
        "type": "line", "y0": 0, "y1": 1, "yref": "paper", "x0": value, "x1": value, "label_text": text,
        "line": {"color": style.colour, "dash": style.dash, "width": style.width_px},
    }  # fmt: skip


# Numbers ------------------------------------------------------------------------------------------------------------


def numbers(values: Array | Sequence[float]) -> dict[str, str]:
    """Pack numbers, shape (n,), in single precision, as plotly.js takes them; what it cannot draw is not a number."""
    wide = np.asarray(values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        drawable = np.where(np.abs(wide) < OVERFLOW, wide, np.nan)
    return {"dtype": "f4", "bdata": base64.b64encode(drawable.astype("<f4").tobytes()).decode("ascii")}


def thinned(x: Array, y: Array, count: int = POINTS) -> NDArray[np.intp]:
    """Choose at most ``count`` rows, rising, of a line over x, both of shape (n,).

    The line is cut into spans, short ones where it moves much; of each span the lowest and the highest row are kept. So
    no extreme is lost, and what happens fast can be looked at closely.
    """
    if len(x) <= count:
        return np.arange(len(x))
    with np.errstate(invalid="ignore"):
        finite = np.where(np.abs(y) < OVERFLOW, y, 0.0)
    moved = np.abs(np.diff(finite, prepend=finite[0]))
    elapsed = np.diff(x, prepend=x[0])
    busy = elapsed / max(elapsed.sum(), 1e-300) + moved / max(moved.sum(), 1e-300)
    place = np.cumsum(busy) / busy.sum() * (count // 2 - 2)
    starts = np.flatnonzero(np.diff(np.floor(place), prepend=-1.0))
    groups = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(x)))
    order = np.lexsort((finite, groups))
    ends = np.append(starts[1:], len(x)) - 1
    gaps = _edges(~(np.abs(y) < OVERFLOW))
    return np.unique(np.concatenate([[0], order[starts], order[ends], gaps[: count // 4], [len(x) - 1]]))


def _edges(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows at which flags, shape (n,), change, and those before: so gaps stay gaps."""
    changed = np.flatnonzero(flags[1:] != flags[:-1])
    return np.unique(np.concatenate([changed, changed + 1]))


def largest(values: Array, ceiling: float = np.inf) -> float:
    """Return the largest finite magnitude, at most the ceiling; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(min(finite.max(initial=0.0), ceiling))


def length_unit(largest_m: float) -> tuple[float, str]:
    """Choose a readable unit for lengths up to this one: its number in a metre, and its name."""
    for limit, scale, unit in ((2e-4, 1e6, "µm"), (0.05, 1e3, "mm"), (0.5, 1e2, "cm")):
        if 0.0 < largest_m < limit:
            return scale, unit
    return 1.0, "m"


def angle_unit(largest_rad: float) -> tuple[float, str]:
    """Choose a readable unit for angles up to this one: its number in a radian, and its name."""
    for limit, scale, unit in ((2e-4, 1e6, "µrad"), (0.1, 1e3, "mrad")):
        if 0.0 < largest_rad < limit:
            return scale, unit
    return 1.0, "rad"
