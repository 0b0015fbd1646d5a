"""A step: the robot starts beside its reference, and its way back is held against what the gains promise."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from host_sim.drive import Drive, drive, start_state
from host_sim.errors import OmnibotError
from host_sim.link import Link
from host_sim.metrics import wrap_angle
from host_sim.parameters import plain
from host_sim.plant import Plant
from host_sim.robot import Array, Robot
from host_sim.run import prepare
from host_sim.scenario import Scenario
from host_sim.step_response import Gains, Traits, fit, traits
from host_sim.trace import Trace
from host_sim.trajectory import Polyline, Segment, Trajectory

OUTPUTS = {"p1": "m", "p2": "m", "heading": "rad"}
# The wire has 10 µm and 0.1 mrad; the largest is where a straight way back leaves the linear law far behind.
LEAST = {"p1": 1e-3, "p2": 1e-3, "heading": 1e-2}
MOST = {"p1": 1.5, "p2": 1.5, "heading": 3.0}
DURATION_S = (0.5, 60.0)
DECAYED = 8.0  # time constants of the slowest pole: e^-8 is a third of a per mille
AT_BOUND = 0.99


@dataclass(frozen=True)
class Step:
    """Where the robot starts beside its reference, which moves along the world's first axis.

    Attributes
    ----------
    offset
        Of p1 and p2, m, and of the heading, rad.
    speed_m_per_s
        Of the reference, and of the robot at the start.
    duration_s
        None: as long as the slowest pole needs.
    """

    offset: tuple[float, float, float]
    speed_m_per_s: float = 0.0
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if not any(self.offset):
            raise OmnibotError("a step needs an offset: give --p1, --p2 or --heading")
        for (name, unit), value in zip(OUTPUTS.items(), self.offset, strict=True):
            if value != 0.0 and not LEAST[name] <= abs(value) <= MOST[name]:
                raise OmnibotError(f"--{name} {value:g} must be 0, or {LEAST[name]:g} … {MOST[name]:g} {unit} in size")
        if not 0.0 <= self.speed_m_per_s <= 3.0:
            raise OmnibotError(f"--speed {self.speed_m_per_s:g} must be 0 … 3 m/s")
        if self.duration_s is not None and not DURATION_S[0] <= self.duration_s <= DURATION_S[1]:
            raise OmnibotError(f"--duration {self.duration_s:g} must be {DURATION_S[0]:g} … {DURATION_S[1]:g} s")

    def trajectory(self, duration_s: float) -> Trajectory:
        """Return the reference: p1 at a steady speed, p2 and heading 0."""
        coefficients = np.zeros((3, 8))
        coefficients[0, 1] = self.speed_m_per_s * duration_s
        path = Polyline(np.array([[0.0, 0.0], [coefficients[0, 1], 0.0]]), closed=False)
        return Trajectory([Segment(round(1e6 * duration_s), coefficients)], path)


@dataclass(frozen=True)
class Decay:
    """One output of a step: error over time, and the gains that it ought to show."""

    name: str
    unit: str
    offset: float
    promised: Gains
    time_s: Array
    error: Array

    @property
    def promise(self) -> Array:
        """The error as the gains promise it, shape (n,)."""
        return self.offset * self.promised.response(self.time_s)

    def fitted(self) -> Gains:
        """Return the gains that the measured decay shows."""
        return fit(self.time_s, self.error / self.offset, self.promised)

    def as_dict(self) -> dict[str, Any]:
        """Return what is promised, what was measured, and the difference."""
        measured = traits(self.time_s, self.error / self.offset)
        promised = traits(self.time_s, self.promise / self.offset)
        return {
            "name": self.name,
            "unit": self.unit,
            "offset": self.offset,
            "promised": _told(self.promised, promised),
            "measured": _told(self.fitted(), measured),
            "rms_difference": float(np.sqrt(np.mean((self.error - self.promise) ** 2))),
        }


def _told(gains: Gains, seen: Traits) -> dict[str, Any]:
    """Return gains and traits as plain values; poles as real and imaginary part."""
    return {
        **asdict(gains),
        "natural_frequency_rad_per_s": gains.natural_frequency_rad_per_s,
        "damping_ratio": gains.damping_ratio,
        "poles_per_s": [[pole.real, pole.imag] for pole in gains.poles_per_s],
        **asdict(seen),
    }


def promised_gains(values: Mapping[str, float]) -> dict[str, Gains]:
    """Return what the firmware's parameters promise each output; with the paper's two the heading has none."""
    position = Gains(values["position_stiffness_per_s2"], values["position_damping_per_s"])
    heading = Gains(values["heading_stiffness_per_s2"], values["heading_damping_per_s"])
    gains = {"p1": position, "p2": position}
    return gains if values["output"] == 1.0 else gains | {"heading": heading}


def stepped(scenario: Scenario, step: Step, robot: Robot) -> dict[str, tuple[float, Gains]]:
    """Return offset and gains of the outputs that have an offset, and make sure that the gains promise a decay."""
    told = {p.name: p.default for p in robot.parameters} | scenario.firmware_parameters(robot)
    gains = promised_gains(told)
    offsets = {name: value for name, value in zip(OUTPUTS, step.offset, strict=True) if value != 0.0}
    for name in offsets:
        if name not in gains:
            raise OmnibotError("with --output point nothing holds the heading: leave --heading 0")
        if gains[name].stiffness_per_s2 < 1.0:
            kind = "heading" if name == "heading" else "position"
            raise OmnibotError(f"{kind}_stiffness_per_s2 below 1 brings nothing back: it must be 1 or above for a step")
    return {name: (value, gains[name]) for name, value in offsets.items()}


def duration_of(step: Step, decaying: Mapping[str, tuple[float, Gains]]) -> float:
    """Return how long is driven, whole milliseconds: until the slowest pole has died away, a minute at most."""
    if step.duration_s is not None:
        return round(step.duration_s, 3)
    slowest = min(-gains.poles_per_s[0].real for _, gains in decaying.values())
    return round(min(max(DECAYED / max(slowest, 1e-3), DURATION_S[0]), DURATION_S[1]), 3)


def beside(trajectory: Trajectory, offset: tuple[float, float, float]) -> Trajectory:
    """Return the trajectory moved by an offset in each output."""
    segments = []
    for segment in trajectory.segments:
        coefficients = segment.coefficients.copy()
        coefficients[:, 0] += offset
        segments.append(Segment(segment.duration_us, coefficients))
    return replace(trajectory, segments=segments)


def decays_of(trace: Trace, decaying: Mapping[str, tuple[float, Gains]]) -> list[Decay]:
    """Return the error of each output that was stepped."""
    gap = trace.point - trace.reference_point
    errors = dict(
        zip(OUTPUTS, (gap[:, 0], gap[:, 1], wrap_angle(trace.pose[:, 2] - trace.reference_heading)), strict=True)
    )
    return [
        Decay(name, OUTPUTS[name], offset, gains, trace.time_s, errors[name])
        for name, (offset, gains) in decaying.items()
    ]


@dataclass(frozen=True)
class StepRun:
    """What came of a step."""

    driven: Drive
    decays: list[Decay]
    result: dict[str, Any]


def run_step(scenario: Scenario, step: Step, robot: Robot, link: Link) -> StepRun:
    """Drive a step in lockstep and measure it."""
    decaying = stepped(scenario, step, robot)
    trajectory = step.trajectory(duration_of(step, decaying))
    actual = scenario.plant_robot(robot)
    plant = Plant(actual, scenario.traction_of(actual), scenario.speed_length_m, scenario.delta_m_per_s)
    plant.reset(*start_state(robot, beside(trajectory, step.offset)))
    ready = prepare(link, robot, scenario, trajectory)
    driven = drive(link, plant, robot, trajectory, sensors=scenario.sensors)
    if len(driven.trace) < 2:
        raise OmnibotError(f"the step ended at once: {driven.reason}")
    decays = decays_of(driven.trace, decaying)
    result = {
        "status": driven.status.value,
        "reason": driven.reason,
        "step": {
            **dict(zip(OUTPUTS, step.offset, strict=True)),
            "speed_m_per_s": step.speed_m_per_s,
            "duration_s": trajectory.duration_us * 1e-6,
        },
        "outputs": [decay.as_dict() for decay in decays],
        "bounds": bounds_met(driven.trace, ready.values),
        "scenario": {name: value for name, value in asdict(scenario).items() if name != "path"},
        "parameters": {p.name: plain(p, ready.values[p.name]) for p in robot.parameters},
    }
    return StepRun(driven, decays, result)


def bounds_met(trace: Trace, values: Mapping[str, float]) -> dict[str, float]:
    """Return the largest force and torque, their bounds, and the share of ticks near one: no linear law holds there."""
    force, torque = (np.abs(column).max(axis=1) for column in (trace.wheel_force, trace.torque))
    force_bound, torque_bound = values["force_bound_N"], values["torque_bound_Nm"]
    near = (force >= AT_BOUND * force_bound) | (torque >= AT_BOUND * torque_bound)
    return {
        "max_wheel_force_N": float(force.max()),
        "force_bound_N": force_bound,
        "max_torque_Nm": float(torque.max()),
        "torque_bound_Nm": torque_bound,
        "fraction_at_bound": float(near.mean()),
    }


def table_rows(outputs: list[dict[str, Any]]) -> list[list[str]]:
    """Tabulate the outputs, a head first: each figure promised and measured."""
    rows = [["", *(f"{output['name']} {side}" for output in outputs for side in ("promised", "measured"))]]
    for title, key in (
        ("natural frequency (rad/s)", "natural_frequency_rad_per_s"),
        ("damping ratio (1)", "damping_ratio"),
        ("poles (1/s)", "poles_per_s"),
        ("rise, 10 to 90 % (s)", "rise_s"),
        ("overshoot (%)", "overshoot"),
        ("settling to 2 % (s)", "settling_s"),
    ):
        cells = [output[side][key] for output in outputs for side in ("promised", "measured")]
        rows.append([title, *(_cell(key, cell) for cell in cells)])
    differences = [cell for output in outputs for cell in ("", _difference(output))]
    return [*rows, ["RMS difference", *differences]]


def _difference(output: dict[str, Any]) -> str:
    share = output["rms_difference"] / abs(output["offset"])
    unit, factor = ("mm", 1e3) if output["unit"] == "m" else ("mrad", 1e3)
    return f"{factor * output['rms_difference']:.3g} {unit}, {100.0 * share:.2g} %"


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "none"
    if key == "poles_per_s":
        (real, imaginary), (other, _) = value
        return f"{real:.2f} ± {imaginary:.2f}i" if imaginary else f"{real:.2f}, {other:.2f}"
    return f"{100.0 * value:.2f}" if key == "overshoot" else f"{value:.4g}"
