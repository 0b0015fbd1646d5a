"""The target's instructions against the host's build, bit for bit; and planted differences, which must be found."""

import subprocess
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from step_cost.corpus import AFTER_GAP, BRAKING, FAULT, IDLE_TICK, NODE, SEED, SETUP, TICK, Wire, sessions
from step_cost.equality import DifferenceError, Equality, Host
from step_cost.image import Image
from step_cost.layout import layouts

ROOT = Path(__file__).parents[2]
HOST = ROOT / "build" / "host"
CONTROL = ("control", "floor", "kinematics", "manifold", "tracking", "trajectory", "trigonometry")
ANGLES = 20_000


def image() -> Image:
    return Image(ROOT / "build" / "target" / "step-cost.elf")


def test_target_and_host_agree_bit_for_bit_over_the_corpus() -> None:
    equality = Equality(image(), HOST)
    for session in sessions():
        equality.session(session)
    assert equality.compared.control_steps > 20_000
    assert equality.compared.frames > 2 * equality.compared.control_steps


def test_target_and_host_agree_on_random_angles() -> None:
    equality = Equality(image(), HOST)
    equality.trigonometry(ANGLES, np.random.default_rng(SEED))
    assert equality.compared.angles >= ANGLES


# ---- planted differences


def host_built(folder: Path, library: str, *flags: str, planted: tuple[str, str, str] | None = None) -> Path:
    """A host build with one library made anew: with other flags, or with one text of a source replaced."""
    firmware, generated = ROOT / "firmware", HOST / "generated"
    for file in [*(firmware / "control").glob("*.[ch]"), generated / "robot_constants.c"]:
        text = file.read_text(encoding="utf-8")
        if planted is not None and file.name == planted[0]:
            assert text.count(planted[1]) == 1
            text = text.replace(planted[1], planted[2])
        (folder / file.name).write_text(text, encoding="utf-8")
    sources = [folder / f"{name}.c" for name in (*CONTROL, "robot_constants")]
    if library == "libomnibot.so":
        sources += [*(firmware / "app").glob("*.c"), firmware / "ports" / "posix" / "inproc.c"]
        sources += [
            ROOT / "protocol" / "crc.c",
            generated / "messages.c",
            *(generated / f"{table}_table.c" for table in ("parameter", "fault")),
        ]
    includes = [f"-I{place}" for place in (folder, firmware / "app", ROOT / "protocol", generated)]
    command = ["cc", "-std=c11", "-O2", "-g", "-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno"]
    subprocess.run([*command, *flags, *includes, *map(str, sources), "-lm", "-o", str(folder / library)], check=True)
    other = ({"libomnibot.so", "libcontrol-visible.so"} - {library}).pop()
    (folder / other).symlink_to(HOST / other)
    return folder


def run_some(host: Path) -> None:
    equality = Equality(image(), host)
    equality.trigonometry(200, np.random.default_rng(SEED))
    for session in islice(sessions(("observer",)), 4):
        equality.session(session)


@pytest.mark.parametrize("library", ["libomnibot.so", "libcontrol-visible.so"])
def test_same_sources_built_by_the_test_agree(library: str, tmp_path: Path) -> None:
    run_some(host_built(tmp_path, library))


def test_constant_off_by_its_last_digit_is_found_in_the_trigonometry(tmp_path: Path) -> None:
    planted = ("trigonometry.c", "1.6666654611e-1f", "1.6666656e-1f")
    with pytest.raises(DifferenceError, match=r"angle \S+: the target makes"):
        run_some(host_built(tmp_path, "libcontrol-visible.so", planted=planted))


def test_sum_taken_in_another_order_is_found_in_control_step(tmp_path: Path) -> None:
    planted = ("kinematics.c", "a.x * b.x + a.y * b.y + ", "a.y * b.y + a.x * b.x + 1e-7f * b.x + ")
    with pytest.raises(DifferenceError, match="control_step: target and host differ in"):
        run_some(host_built(tmp_path, "libcontrol-visible.so", planted=planted))


def test_rearranged_arithmetic_is_found(tmp_path: Path) -> None:
    flags = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-freciprocal-math")
    with pytest.raises(DifferenceError):
        run_some(host_built(tmp_path, "libcontrol-visible.so", *flags))


def test_difference_in_what_is_remembered_is_found_in_the_firmwares_memory(tmp_path: Path) -> None:
    planted = ("control.c", "0.5f * period_s, acceleration", "0.50001f * period_s, acceleration")
    with pytest.raises(DifferenceError, match=r"app_t: target and host differ in state\.pose"):
        run_some(host_built(tmp_path, "libomnibot.so", planted=planted))


def test_other_robot_constants_are_refused(tmp_path: Path) -> None:
    planted = ("robot_constants.c", ".wheel_radius_m = ", ".wheel_radius_m = 1.0f + ")
    with pytest.raises(DifferenceError, match="the robot's constants differ"):
        run_some(host_built(tmp_path, "libcontrol-visible.so", planted=planted))


# ---- the corpus itself


@pytest.mark.parametrize("order", ["0", "observer"])
def test_groups_of_the_corpus_are_what_they_are_called(order: str) -> None:
    torque = Wire().codec["TORQUE"]
    expected = {TICK: ["TRACKING"], AFTER_GAP: ["TRACKING"], FAULT: ["FAULT"], BRAKING: ["STOPPING"], SETUP: []}
    seen = set()
    for session in sessions((order,)):
        host = Host(HOST / "libomnibot.so")
        for number, group in enumerate(session.groups):
            answers = [
                torque.named(f.data) for f in host.exchange(group.frames) if f.identifier == torque.arbitration_id
            ]
            modes = [torque.label("mode", answer["mode"]) for answer in answers]
            assert group.kind == IDLE_TICK or modes == expected[group.kind], (session.name, number)
            seen.add(group.kind)
    assert seen == {TICK, AFTER_GAP, FAULT, BRAKING, IDLE_TICK, SETUP}


def test_bounds_act_and_do_not_in_the_corpus() -> None:
    equality = Equality(image(), HOST)
    output = layouts(equality.target.image.file)["control_output_t"]
    for session in islice(sessions(("observer",)), 7):
        equality.target.start(NODE)
        for group in session.groups:
            equality.target.exchange(group.frames)
    steps = [output.numbers(step.output) for step in equality.captures.steps]
    bounded = {(step["force_bounded"], step["torque_bounded"]) for step in steps}
    assert bounded == {(0, 0), (1, 0), (0, 1), (1, 1)}


def test_corpus_is_the_same_each_time() -> None:
    first, again = (list(islice(sessions(("1",)), 7)) for _ in range(2))
    assert first == again
