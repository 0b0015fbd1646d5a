"""The page of a plan: the path with the robot on it, coloured by speed, and what it asks for beside what it may."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from host_sim.limits import QUANTITIES
from host_sim.preview import Preview
from host_sim.report import page
from host_sim.report.figure import LIMIT, STYLES, Axis, Drawn, Figure, Panel, curve, level, line, numbers
from host_sim.report.path import PATH, HEIGHT_px, evenly, robots_at, written_times
from host_sim.report.run import length_text, percent_text
from host_sim.robot import Array
from host_sim.trace import write_atomically

NUMBERS_FILE = "plan.json"
DOTS = 1500  # of the path, each with the colour of its speed
CEILING = 10.0  # shares of a limit beyond are off the axis
CAPTION = (
    "The path from above with the robot to scale, its arm from the centre to the tracked point; and what the reference "
    "asks of the robot, as a share of each limit."
)


def write_plan(folder: Path, preview: Preview, command: str) -> Path:
    """Write ``report.html`` and ``plan.json`` into a folder, made if need be; return the page."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / page.PAGE_NAME
    write_atomically(file, plan_page(preview, command).encode())
    write_atomically(folder / NUMBERS_FILE, (json.dumps(preview.numbers(), indent=2) + "\n").encode())
    return file


def plan_page(preview: Preview, command: str) -> str:
    """Compose the page; the command is the one that makes it again."""
    told = preview.numbers()
    tiles = [
        page.Tile("Length", length_text(told["length_m"]), "driven by the tracked point", "length_m"),
        page.Tile("Duration", f"{told['duration_s']:.4g} s", "from rest to rest", "duration_s"),
        page.Tile("Segments", str(told["segments"]), f"{told['profile']} speed", "segments"),
        page.Tile("Fit", length_text(told["fit_error_m"]), "largest distance from the path asked for", "fit_error_m"),
    ]
    blocks = [
        page.tiles(tiles),
        page.figures([Figure("plan", CAPTION, [_path_panel(preview), _share_panel(preview)], wide=True)]),
        page.table(_asked_table(told["asked"])),
        page.heading("To repeat it"),
        page.command(command),
    ]
    return page.compose(f"Plan of the {Path(told['path']).name} path", "omnibot plan", blocks)


def _path_panel(preview: Preview) -> Panel:
    """Draw the path asked for, the point's way in colours of its speed, and the robot at six instants."""
    outline, motion = preview.plan.trajectory.path.outline(), preview.motion
    rows = evenly(len(motion.time_s), DOTS)
    instants = np.linspace(0.0, preview.plan.trajectory.duration_us * 1e-6, 6)
    poses = _centre_poses(preview, instants)
    traces = [
        line(outline[:, 0], outline[:, 1], "path asked for", PATH, hoverinfo="skip"),
        *robots_at(preview.robot, poses, "robot at instants"),
        written_times(preview.robot, poses, instants),
        _dots(motion.point[rows], motion.asked["speed_m_per_s"][rows], motion.time_s[rows]),
    ]
    return Panel("Path from above (m)", traces, Axis("x1 (m)"), Axis("x2 (m)"), equal=True, height_px=HEIGHT_px)


def _dots(points: Array, speed_m_per_s: Array, time_s: Array) -> Drawn:
    """Draw points, shape (n, 2) in m, each in the colour of its speed."""
    scale = {"color": numbers(speed_m_per_s), "colorscale": "Viridis", "showscale": True, "size": 4}
    bar = {
        "title": {"text": "speed (m/s)", "side": "top"},
        "orientation": "h",
        "y": 1.0,
        "yanchor": "bottom",
        "thickness": 8,
    }
    told = "at %{customdata:.3f} s: %{x:.4g}, %{y:.4g} m, %{marker.color:.4g} m/s<extra></extra>"
    return line(
        points[:, 0], points[:, 1], "tracked point p", STYLES[0],
        mode="markers", marker={**scale, "colorbar": bar}, customdata=numbers(time_s), hovertemplate=told,
    )  # fmt: skip


def _centre_poses(preview: Preview, time_s: Array) -> Array:
    """Return the robot's poses, shape (k, 3), at times (k,): the point is ahead of it, along its second axis."""
    place = preview.plan.trajectory.evaluate(time_s, derivatives=0)[:, 0]
    ahead = np.column_stack([-np.sin(place[:, 2]), np.cos(place[:, 2])])
    return np.column_stack([place[:, :2] - preview.robot.tracked_point_offset_m * ahead, place[:, 2]])


def _share_panel(preview: Preview) -> Panel:
    """Draw every quantity that has a limit, as a share of it."""
    time_s, asked = preview.motion.time_s, preview.motion.asked
    limits = {name: getattr(preview.limits, name) for name in QUANTITIES}
    shares = {name: asked[name] / limit for name, limit in limits.items() if limit is not None}
    traces = [
        curve(time_s, share, f"{QUANTITIES[name][0]}, of {limits[name]:.4g} {QUANTITIES[name][1]}", style)
        for (name, share), style in zip(shares.items(), STYLES, strict=False)
    ]
    highest = max([1.0, *(float(share.max()) for share in shares.values())])
    view = (0.0, min(1.1 * highest, CEILING))
    shapes = [level(1.0, "limit", LIMIT)]
    return Panel("Share of each limit (1)", traces, Axis("time (s)"), Axis(view=view), shapes, height_px=HEIGHT_px)


def _asked_table(asked: dict[str, dict[str, Any]]) -> page.Table:
    """Tabulate the largest of each quantity, its limit, and where it is."""
    rows = []
    for name, (what, unit) in QUANTITIES.items():
        value = asked[name]
        limited = value["limit"] is not None
        limit = (f"{value['limit']:.4g} {unit}", percent_text(value["share"])) if limited else ("none", "")
        place = f"{value['x1_m']:.3f} m, {value['x2_m']:.3f} m"
        rows.append([what, f"{value['largest']:.4g} {unit}", *limit, place, f"{value['time_s']:.3f} s"])
    return page.Table("What it asks for", ["", "largest", "limit", "share", "at", "at time"], rows)
