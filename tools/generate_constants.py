#!/usr/bin/env python3
"""Write the C constants of a robot file: generate_constants.py ROBOT.toml OUTPUT_FOLDER.

robot_constants.c holds the robot and the manifold's constant matrices (firmware/control/THEORY.md), computed in double;
wheel_layout.h says which form they have (firmware/control/wheels.h);
motor_constants.c holds the board's motors; parameter_table.h and .c hold the parameters that can be set over CAN.
"""

import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from host_sim.errors import OmnibotError
from host_sim.robot import Parameter, Robot, load_robot

# FLOOR_CURVE_INTERVALS of firmware/control/floor.h; the compiler complains if there are more points than that.
CURVE_INTERVALS = 64
FORCE_SHARE_MAX = 0.95

# Share of the largest entry of Jr by which another may be off and the wheels still be three at 120 degrees: rounding.
ALIKE = 1e-12

Matrix = NDArray[np.floating[Any]]

NOTE = "// Generated from {source} by tools/generate_constants.py; do not edit.\n"


def c_float(value: float) -> str:
    """Return a C literal of single precision that reads back as the nearest float."""
    text = f"{float(np.float32(value)):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def c_numbers(*numbers: float) -> str:
    """Return the initialiser of a struct of floats."""
    return "{" + ", ".join(c_float(x) for x in numbers) + "}"


def c_matrix(matrix: Matrix) -> str:
    """Return the initialiser of a mat3_t."""
    return "{{" + ", ".join(c_numbers(*row) for row in matrix) + "}}"


def is_alike(matrix: Matrix) -> bool:
    """Whether a matrix from the body to the wheels is Jr of three equal wheels at 120 degrees, its columns scaled."""
    ahead, side, turn = matrix[2]
    form = np.array([[-ahead, side, turn], [0.0, -2.0 * side, turn], [ahead, side, turn]])
    return np.allclose(matrix, form, rtol=0.0, atol=ALIKE * np.abs(matrix).max())


def geometry_fields(robot: Robot) -> list[tuple[str, str, str]]:
    """Return field, initialiser and source formula of what depends on where the wheels stand, as wheels.h has it."""
    jr, r = robot.Jr, robot.wheel_radius_m
    maps = [
        ("wheel_rate_of_twist", jr / r, "J = Jr / r"),
        ("inertia_torque_of_accel", jr / r * robot.wheel_inertia_kg_m2, "Iw J"),
        ("twist_of_wheel_rate", r * np.linalg.inv(jr).T, "J^-1"),
        ("twist_of_contact_speed", np.linalg.inv(jr).T, "Jr^-1"),
        ("wheel_force_of_specific", np.linalg.inv(jr.T) @ np.diag(robot.Mo), "Lambda = Jr^-T Mo"),
    ]
    slip_mass = np.linalg.inv(jr.T @ jr) @ np.diag(robot.Mo)
    mobility_inverse = np.linalg.inv(jr @ jr.T + r**2 * np.eye(3))
    if not is_alike(jr):
        fields = [(name, c_matrix(matrix), formula) for name, matrix, formula in maps]
        fields.append(("slip_mass", c_matrix(slip_mass), "Jr^-1 Lambda = (Jr^T Jr)^-1 Mo"))
        return [*fields, ("slip_mobility_inverse", c_matrix(mobility_inverse), "Gamma^-1 = (Jr Jr^T + r^2 I)^-1")]
    of_sum = mobility_inverse[0, 1]  # the rest is diagonal
    return [
        *((name, c_numbers(*matrix[2]), formula) for name, matrix, formula in maps),
        ("slip_mass", c_numbers(*np.diag(slip_mass)), "diagonal of Jr^-1 Lambda = (Jr^T Jr)^-1 Mo"),
        (
            "slip_mobility_inverse",
            c_numbers(mobility_inverse[0, 0] - of_sum, of_sum),
            "Gamma^-1 = (Jr Jr^T + r^2 I)^-1 where the wheels sum to 0, and what it adds, of their sum",
        ),
    ]


def layer_rate(robot: Robot) -> float:
    """Return the slowest eigenvalue of M22 Gamma^2 = Jr Mo^-1 Jr^T + r^2/Iw I: the boundary layer (18) dies by it."""
    rates = robot.Jr / robot.Mo @ robot.Jr.T + robot.wheel_radius_m**2 / robot.wheel_inertia_kg_m2 * np.eye(3)
    return float(np.linalg.eigvalsh(rates).min())


def c_curve(robot: Robot) -> str:
    """Return the initialiser of a floor_curve_t: the rising branch of the magic formula, slip from force.

    u = sin(C atan y) with y = (1 - E) x + E atan x and x = B s, so s / (eps Dp) = C x: C x / u times the linear floor's
    slip. The branch is left a little below the peak, where its slope is without bound.
    """
    force_share = np.linspace(0.0, FORCE_SHARE_MAX, CURVE_INTERVALS + 1)
    y = np.tan(np.arcsin(force_share) / robot.magic_shape)
    e = robot.magic_curvature
    x = y.copy()
    for _ in range(50):  # concave in x: Newton from the left rises to the root
        x += (y - (1.0 - e) * x - e * np.arctan(x)) / ((1.0 - e) + e / (1.0 + x * x))
    softening = np.concatenate([[1.0], robot.magic_shape * x[1:] / force_share[1:]])
    points = ", ".join(c_float(k) for k in softening)
    return f"{{{c_float(FORCE_SHARE_MAX)}, {{{points}}}}}"


def robot_fields(robot: Robot) -> list[tuple[str, str, str]]:
    """Return field, initialiser and source formula of a robot_t."""
    r = robot.wheel_radius_m
    period_us = round(1e6 * robot.control_period_s)
    return [
        ("tracked_point_offset_m", c_float(robot.tracked_point_offset_m), "L"),
        ("wheel_radius_m", c_float(r), "r"),
        ("wheel_inertia_kgm2", c_float(robot.wheel_inertia_kg_m2), "Iw"),
        ("normalised_compliance_per_N", c_float(1.0 / robot.normalised_stiffness_N), "1/G0"),
        ("wheel_rate_of_contact_speed_per_m", c_float(1.0 / r), "1/r"),
        ("control_period_s", c_float(robot.control_period_s), "T"),
        ("control_period_us", f"{period_us}u", "T"),
        *geometry_fields(robot),
        ("layer_lag_Ns2_per_m", c_float(1.0 / layer_rate(robot)), "over the slowest eigenvalue of M22 Gamma^2"),
        ("floor_curve", c_curve(robot), "magic formula turned round: s / (eps lambda / G0)"),
        ("wheel_distance_m", c_float(robot.wheel_distance_m), "b"),
        ("file_checksum", f"0x{robot.checksum:08X}u", "of the robot file"),
    ]


def constants_source(robot: Robot) -> str:
    """Return robot_constants.c."""
    lines = [f"    .{field} = {value}, // {formula}" for field, value, formula in robot_fields(robot)]
    return '#include "robot.h"\n\nconst robot_t omnibot = {\n' + "\n".join(lines) + "\n};\n"


def layout_header(robot: Robot) -> str:
    """Return wheel_layout.h: which form the maps between body and wheels have."""
    meaning = "three equal wheels at 120 degrees, in the order of (K1)"
    return (
        "#ifndef OMNIBOT_WHEEL_LAYOUT_H\n#define OMNIBOT_WHEEL_LAYOUT_H\n\n"
        f"#define OMNIBOT_WHEELS_ALIKE {int(is_alike(robot.Jr))} // {meaning}\n\n#endif\n"
    )


def motor_source(robot: Robot) -> str:
    """Return motor_constants.c: the motors of the board (firmware/ports/stm32f405/motor.h)."""
    motor = robot.motor
    fields = [
        ("resistance_Ohm", motor.resistance_Ohm),
        ("torque_constant_Nm_A", motor.torque_constant_Nm_per_A),
        ("gear_ratio", motor.gear_ratio),
        ("supply_nominal_V", motor.supply_nominal_V),
        ("encoder_counts", motor.encoder_counts * motor.gear_ratio),
    ]
    lines = [f"    .{name} = {c_float(number)}," for name, number in fields]
    return '#include "motor.h"\n\nconst motor_t omnibot_motor = {\n' + "\n".join(lines) + "\n};\n"


def table_hash(parameters: tuple[Parameter, ...]) -> int:
    """Return the CRC-32 of what gives a kept value its meaning: index, name, unit, type and range, not the default."""
    rows = (
        f"{p.index} {p.name} {p.unit} {'integer' if p.integer else 'real'} {c_float(p.minimum)} {c_float(p.maximum)}\n"
        for p in parameters
    )
    return zlib.crc32("".join(rows).encode())


def table_header(parameters: tuple[Parameter, ...]) -> str:
    """Return parameter_table.h: an index a parameter."""
    names = "\n".join(f"    PARAMETER_{p.name.upper()} = {p.index}, // {p.unit}; {p.source}" for p in parameters)
    return (
        "#ifndef OMNIBOT_PARAMETER_TABLE_H\n#define OMNIBOT_PARAMETER_TABLE_H\n\n#include <stdbool.h>\n\n"
        f"#define PARAMETER_TABLE_HASH 0x{table_hash(parameters):08X}u // index, name, unit, type and range of all\n\n"
        f"enum {{\n{names}\n    PARAMETER_COUNT = {len(parameters)}\n}};\n\n"
        "typedef struct {\n    float minimum, maximum, initial;\n    bool integer;\n"
        "    const char *name, *unit; // ASCII\n} parameter_description_t;\n\n"
        "extern const parameter_description_t parameter_table[PARAMETER_COUNT];\n\n#endif\n"
    )


def table_source(parameters: tuple[Parameter, ...]) -> str:
    """Return parameter_table.c: range and default of each parameter."""
    rows = "\n".join(
        f"    [PARAMETER_{p.name.upper()}] = {{{c_float(p.minimum)}, {c_float(p.maximum)}, {c_float(p.default)}, "
        f'{"true" if p.integer else "false"}, "{p.name}", "{p.unit}"}},'
        for p in parameters
    )
    table = "const parameter_description_t parameter_table[PARAMETER_COUNT]"
    return f'#include "parameter_table.h"\n\n{table} = {{\n{rows}\n}};\n'


def main() -> None:
    """Generate robot_constants.c, wheel_layout.h, motor_constants.c, parameter_table.h and parameter_table.c."""
    if len(sys.argv) != 3:
        sys.exit("usage: generate_constants.py ROBOT.toml OUTPUT_FOLDER")
    source, folder = Path(sys.argv[1]), Path(sys.argv[2])
    try:
        robot = load_robot(source)
    except OmnibotError as error:
        sys.exit(str(error))
    if [p.index for p in robot.parameters] != list(range(len(robot.parameters))):
        sys.exit(f"{source}: the parameters' indices must be 0, 1, 2 … in order")
    note = NOTE.format(source=source.name)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot_constants.c").write_text(note + constants_source(robot), encoding="utf-8")
    (folder / "wheel_layout.h").write_text(note + layout_header(robot), encoding="utf-8")
    (folder / "motor_constants.c").write_text(note + motor_source(robot), encoding="utf-8")
    (folder / "parameter_table.h").write_text(note + table_header(robot.parameters), encoding="utf-8")
    (folder / "parameter_table.c").write_text(note + table_source(robot.parameters), encoding="utf-8")


if __name__ == "__main__":
    main()
