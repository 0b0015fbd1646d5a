"""The fuzz targets: each thing planted into the firmware is found by the runs of tools/fuzz --short, or by flood."""

import json
import re
import shlex
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build" / "fuzz"
TARGETS = BUILD / "tests" / "fuzz"

# File, what stands there, what is put in its place, the target that must find it, and what it must say.
PLANTED = {
    "torque outside TRACKING": (
        "firmware/app/pace.c",
        "compose_answers(app, &output);",
        "compose_answers(app, &(control_output_t){.torque_Nm = {0.1f, 0.0f, 0.0f}});",
        "app",
        "zero unless TRACKING or STOPPING",
    ),
    "no torque bound": (
        "firmware/control/control.c",
        "scale_to_bound(force_scale * vec3_max_abs(torque), params->torque_bound_Nm)",
        "scale_to_bound(force_scale * vec3_max_abs(torque), 1.0e9f)",
        "app",
        "within its bound",
    ),
    "bridges on in FAULT": (
        "firmware/app/pace.c",
        "app->port.drive == DRIVE_MOTORS && mode_drives(app->mode)",
        "app->port.drive == DRIVE_MOTORS && app->mode != MODE_IDLE",
        "app",
        "bridges on in MOTORS while TRACKING or STOPPING",
    ),
    "the torque of the drive before": (
        "firmware/app/app.c",
        "    app->torque_Nm = (vec3_t){0};",
        "    //",
        "app",
        "zero before the first step",
    ),
    "a fault that STOP clears": (
        "firmware/app/mode.c",
        "[MODE_FAULT] = {[EVENT_CLEAR] = TO(MODE_IDLE)}",
        "[MODE_FAULT] = {[EVENT_CLEAR] = TO(MODE_IDLE), [EVENT_STOP] = TO(MODE_IDLE)}",
        "app",
        "a fault in FAULT and STOPPING and nowhere else",
    ),
    "no fault of stale wheel speeds": (
        "firmware/app/pace.c",
        "if (is_stale(app, &app->wheel_speed,",
        "if (is_stale(app, &app->pose,",
        "app",
        "a fault",
    ),
    "frames of any node": (
        "firmware/app/app.c",
        "if ((frame->id & FRAME_NODE_MASK) != app->node) {",
        "if (frame->id > 0x7FFu) {",
        "app",
        "frames of other nodes and functions change nothing",
    ),
    "an upload while driving": (
        "firmware/app/app.c",
        "mode_is_safe(app->mode) ? store_begin(",
        "app->peer_matches ? store_begin(",
        "app",
        "TRAJECTORY_ACK",
    ),
    "uploads of any length": (
        "firmware/app/store.c",
        "|| segments > STORE_SEGMENTS_MAX",
        "",
        "setup",
        "TRAJECTORY_ACK: the result that fits",
    ),
    "a write into what follows the segments": (
        "firmware/app/store.c",
        "&store->segment[word / STORE_WORDS_PER_SEGMENT]",
        "&store->segment[word / STORE_WORDS_PER_SEGMENT + STORE_SEGMENTS_MAX]",
        "setup",
        "whole uploads are held",
    ),
    "a write past the store": (
        "firmware/app/store.c",
        "&store->segment[word / STORE_WORDS_PER_SEGMENT]",
        "&store->segment[word / STORE_WORDS_PER_SEGMENT + STORE_SEGMENTS_MAX + 1]",
        "setup",
        "runtime error: index",
    ),
    "parameters of any index": (
        "firmware/app/parameters.c",
        "index >= PARAMETER_COUNT",
        "index > PARAMETER_COUNT",
        "setup",
        "ERROR: AddressSanitizer: global-buffer-overflow",
    ),
    "SLCAN lines of any length": (
        "protocol/slcan.c",
        "if (slcan->line_chars < SLCAN_LINE_CHARS) {",
        "if (slcan->line_chars <= SLCAN_LINE_CHARS) {",
        "slcan",
        "runtime error: index",
    ),
    "SLCAN frames with a byte too many": (
        "protocol/slcan.c",
        "slcan->line_chars != FRAME_HEAD_CHARS + 2 * length",
        "slcan->line_chars < FRAME_HEAD_CHARS + 2 * length",
        "slcan",
        "a frame is given where one is",
    ),
    "another CRC": ("protocol/crc.c", "0x1D, 0x3A", "0x1D, 0x3B", "decoders", "length and CRC decide"),
}


def commands() -> list[dict[str, str]]:
    database = BUILD / "compile_commands.json"
    assert database.exists(), f"{database} is missing; say: tools/build fuzz"
    entries: list[dict[str, str]] = json.loads(database.read_text(encoding="utf-8"))
    return entries


def compile_planted(source: str, text: str, folder: Path) -> Path:
    """Compile a source as the fuzz build does, with another text."""
    entry = next(e for e in commands() if e["file"] == str(ROOT / source) and "watched.dir" in e["command"])
    planted, made = folder / Path(source).name, folder / "planted.o"
    planted.write_text(text, encoding="utf-8")
    command = shlex.split(entry["command"])
    command[command.index("-c") + 1] = str(planted)
    command[command.index("-o") + 1] = str(made)
    command += ["-I", str((ROOT / source).parent), "-Wno-error"]
    subprocess.run(command, cwd=entry["directory"], check=True, capture_output=True, timeout=60)
    return made


def link(target: str, made: Path, folder: Path) -> Path:
    """Link a target with an object that comes before the library's own."""
    program = folder / f"fuzz_{target}"
    objects = [str(o) for o in (TARGETS / "CMakeFiles" / f"fuzz_{target}.dir").glob("*.o")]
    command = ["clang", "-fsanitize=fuzzer,address,undefined", "-o", str(program), *objects, str(made)]
    subprocess.run([*command, str(TARGETS / "libwatched.a"), "-lm"], check=True, capture_output=True, timeout=60)
    return program


def short_options(target: str) -> list[str]:
    """Return what tools/fuzz --short gives the target."""
    runs = re.search(rf"\[{target}\]=(\d+)", (ROOT / "tools" / "fuzz").read_text(encoding="utf-8"))
    assert runs
    return ["-seed=1", "-max_len=512", f"-runs={runs[1]}", str(ROOT / "tests" / "fuzz" / "corpus" / target)]


@pytest.mark.parametrize("planted", PLANTED)
def test_short_run_finds_what_is_planted(planted: str, tmp_path: Path) -> None:
    source, old, new, target, message = PLANTED[planted]
    text = (ROOT / source).read_text(encoding="utf-8")
    assert text.count(old) >= 1, f"{source} has changed: plant '{planted}' elsewhere"
    program = link(target, compile_planted(source, text.replace(old, new), tmp_path), tmp_path)
    scratch = tmp_path / "corpus"
    scratch.mkdir()
    command = [str(program), f"-artifact_prefix={tmp_path}/", *short_options(target)]
    done = subprocess.run(
        [*command[:-1], str(scratch), command[-1]], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode != 0
    assert message in done.stderr


def flood(*arguments: str) -> subprocess.CompletedProcess[str]:
    program = TARGETS / "flood"
    assert program.exists(), f"{program} is missing; say: tools/build fuzz"
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=120, check=False)


def test_flood_counts_its_frames_and_drives() -> None:
    done = flood("200000", "7")
    assert done.returncode == 0, done.stderr
    counts = re.match(r"(\d+) frames, (\d+) steps while TRACKING, programs 7 to \d+", done.stdout)
    assert counts
    assert int(counts[1]) >= 200000
    assert int(counts[2]) > 0.02 * int(counts[1])  # it reaches what is deep


@pytest.mark.parametrize("arguments", [("many",), ("-1",), ("1", "2x")])
def test_flood_names_what_is_no_number(arguments: tuple[str, ...]) -> None:
    done = flood(*arguments)
    assert done.returncode == 2
    assert f"flood: {arguments[-1]} is no whole number" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["app", "soon"], "SECONDS is a whole number above 0, not 'soon'"),
        (["wheels"], "no target 'wheels'; there are:"),
    ],
)
def test_tool_names_what_is_wrong(arguments: list[str], message: str) -> None:
    done = subprocess.run(
        [ROOT / "tools" / "fuzz", *arguments], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode == 2
    assert message in done.stderr
