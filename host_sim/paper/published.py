"""What the paper prints: its numbers, and its formulas that need no simulation; (4) and the like are its equations."""

import numpy as np

from host_sim.robot import Array, Robot

SPEEDS_m_per_s = (0.0234, 0.0468, 0.0702, 0.0936)
FLEXIBLE_EPSILON = 4e-11
TABLE1_FLEXIBLE_m = (5.564e-4, 1.44e-2, 4.66e-2, 0.1423)
TABLE1_RIGID_m = (0.5040, 1.4817, 0.1964, 0.8089)

EPSILON_STAR = 5e-5  # Fig. 3a: 'values greater than ε* unstabilize the system'
COST_s = {1e-8: 0.0, 5e-5: 3500.0}  # read off Fig. 3b; the first is 'near 0'
DURATION_s = 4.5

MU_RANGES_m_per_s = ((-50.0, 150.0), (-200.0, 50.0), (-10e-3, 5e-3))  # axes of Fig. 4

# Fig. 2: B, C, D in N, E, and the ends of the printed axes: abscissa, ordinate in N.
LONGITUDINAL = (0.178, 1.65, 2193.0, 0.432)
LATERAL = (0.244, 1.30, 1936.0, -0.132)
ABSCISSA_END = 15.0
LONGITUDINAL_AXIS_END_N = 2000.0
LATERAL_AXIS_END_N = 2500.0
LINEAR_LIMIT = 0.1  # Assumption 1, of s and of δx in rad


def _magic(constants: tuple[float, float, float, float], abscissa: Array) -> Array:
    """Return D sin(C atan((1 − E) B x + E atan(B x))), in N."""
    b, c, d, e = constants
    bend = (1.0 - e) * b * abscissa + e * np.arctan(b * abscissa)
    return np.asarray(d * np.sin(c * np.arctan(bend)))


def longitudinal_force_N(slip: Array) -> Array:
    """Fy of (4), in N, at slip ratios s, any shape."""
    return _magic(LONGITUDINAL, 100.0 * slip)


def lateral_force_N(slip_angle_deg: Array) -> Array:
    """Fx of (5), in N, at slip angles in degrees, any shape."""
    return _magic(LATERAL, slip_angle_deg)


def longitudinal_stiffness_N() -> float:
    """Return G of (7), N."""
    b, c, d, _ = LONGITUDINAL
    return 100.0 * d * c * b


def lateral_stiffness_N() -> float:
    """Return D of (6), N a degree of slip angle."""
    b, c, d, _ = LATERAL
    return d * c * b


def epsilon_of(fraction: float, exponent: int) -> float:
    """Return ε of (34), 1/N, of Nε and nε."""
    return 10.0**-exponent + fraction * 10.0 ** (1 - exponent)


def epsilon_grid() -> list[float]:
    """Return 1, 2 and 5 of each decade by (34), Nε = 0, 0.1, 0.4, from 1e-9 past the paper's 5e-5 to 1e-2."""
    past = [epsilon_of(fraction, exponent) for exponent in range(9, 2, -1) for fraction in (0.0, 0.1, 0.4)]
    return [*past, epsilon_of(0.0, 2)]


def predicted_epsilon_star(robot: Robot, damping_per_s: float, speed_m_per_s: float) -> float:
    """Return where the sampled expansion turns unstable, ε* = 0.5 · 1.5 G0 / (K2 m (V + δ)); the speed is V + δ."""
    return 0.5 * 1.5 * robot.normalised_stiffness_N / (damping_per_s * robot.mass_kg * speed_m_per_s)
