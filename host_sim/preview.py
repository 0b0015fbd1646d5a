"""A look at a drive before it is driven: length, duration, and what it asks for beside what it may."""

from typing import Any

import numpy as np

from host_sim.limits import QUANTITIES, Limits, Motion, motion_of, robot_limits
from host_sim.planner import PathRequest, Plan, plan_with_limits
from host_sim.robot import Robot
from host_sim.trajectory import MAX_SEGMENTS


class Preview:
    """A plan, and what it asks of the robot."""

    def __init__(self, request: PathRequest, robot: Robot) -> None:
        self.request = request
        self.robot = robot
        self.plan: Plan = plan_with_limits(request, robot)
        self.motion: Motion = motion_of(self.plan.trajectory, robot)
        self.limits: Limits = self.plan.limits.over(robot_limits(robot))

    def numbers(self) -> dict[str, Any]:
        """Return everything as plain values, SI units in the names."""
        trajectory = self.plan.trajectory
        return {
            "path": self.request.path,
            "profile": self.profile,
            "length_m": float(self.motion.distance_m[-1]),
            "duration_s": trajectory.duration_us * 1e-6,
            "segments": len(trajectory.segments),
            "fit_error_m": self.plan.fit_error_m,
            "asked": {name: self._asked(name) for name in QUANTITIES},
        }

    @property
    def profile(self) -> str:
        """What makes the speed."""
        if not self.request.is_fastest:
            return "steady"
        return "timed" if self.plan.is_timed else "fastest"

    def _asked(self, name: str) -> dict[str, Any]:
        k = int(np.argmax(self.motion.asked[name]))
        limit = getattr(self.limits, name)
        return {
            "largest": self.motion.peak(name),
            "limit": limit,
            "share": None if limit is None else self.motion.peak(name) / limit,
            "distance_m": float(self.motion.distance_m[k]),
            "x1_m": float(self.motion.point[k, 0]),
            "x2_m": float(self.motion.point[k, 1]),
            "time_s": float(self.motion.time_s[k]),
        }

    def text(self) -> str:
        """Return it as a person reads it: a line, and a Markdown table."""
        numbers = self.numbers()
        fit = f"{numbers['segments']} of {MAX_SEGMENTS} segments, fit within {1e3 * numbers['fit_error_m']:.1g} mm"
        time = f"{numbers['length_m']:.3f} m in {numbers['duration_s']:.3f} s"
        head = f"{numbers['path']}, {numbers['profile']}: {time}; {fit}"
        rows = [
            "| | largest | limit | share | at, m along the path | x1, m | x2, m | at, s |",
            "| --- |" + " --- |" * 7,
        ]
        rows += [_row(name, asked) for name, asked in numbers["asked"].items()]
        return "\n".join([head, "", *rows])


def _row(name: str, asked: dict[str, Any]) -> str:
    what, unit = QUANTITIES[name]
    limited = asked["limit"] is not None
    limit = f"{asked['limit']:.4g} {unit}" if limited else "–"
    share = f"{100.0 * asked['share']:.1f} %" if limited else "–"
    where = f"{asked['distance_m']:.3f} | {asked['x1_m']:.3f} | {asked['x2_m']:.3f} | {asked['time_s']:.3f}"
    return f"| {what} | {asked['largest']:.4g} {unit} | {limit} | {share} | {where} |"
