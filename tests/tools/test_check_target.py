"""tools/check-target: passes the firmware as it is, and finds each thing planted into it."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHECK = ROOT / "tools" / "check-target"
HOST_LIBRARY = ROOT / "build" / "host" / "libomnibot.so"
FLAGS = "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -O2 -ffunction-sections -fdata-sections -fno-pic"

PLANTED = {
    "malloc": ("void *malloc(unsigned); void *f(void) { return malloc(8); }", "malloc", "no heap"),
    "free": ("void free(void *); void f(void *p) { free(p); }", "free", "no heap"),
    "newlib's allocator": (
        "void *_malloc_r(void *, unsigned); void *f(void) { return _malloc_r(0, 8); }",
        "_malloc_r",
        "no heap",
    ),
    "alloca": (
        "void f(unsigned n) { volatile char *p = __builtin_alloca(n); *p = 0; }",
        "f",
        "no stack of unknown size",
    ),
    "variable length array": (
        "__attribute__((noinline)) static void g(volatile char *p) { *p = 0; } void f(unsigned n) { char a[n]; g(a); }",
        "f",
        "no stack of unknown size",
    ),
    "double multiplication": ("double f(double x) { return x * 1.1; }", "__aeabi_dmul", "no double precision"),
    "double from a forgotten suffix": ("float f(float x) { return x * 1.1; }", "__aeabi_f2d", "no double precision"),
    "double from an integer": ("double f(int i) { return i; }", "__aeabi_i2d", "no double precision"),
    "double comparison": ("int f(double x) { return x < 2.0; }", "__aeabi_dcmplt", "no double precision"),
    "maths library": ("float sinf(float); float f(float x) { return sinf(x); }", "sinf", "no double precision"),
    "fmaxf as a call": (
        "float fmaxf(float, float); float f(float x) { return fmaxf(x, 1.0f); }",
        "fmaxf",
        "no double precision",
    ),
    "printf": (
        'int printf(const char *, ...); int f(void) { return printf("%d", 1); }',
        "printf",
        "no double precision",
    ),
    "initialised variable": ("int planted = 3; int f(void) { return planted++; }", "planted", "no global variables"),
    "zeroed variable": ("int planted; int f(void) { return planted++; }", "planted", "no global variables"),
    "static local": ("int f(void) { static int planted = 1; return planted++; }", "planted.0", "no global variables"),
    "common variable": (
        "int planted __attribute__((common)); int f(void) { return planted++; }",
        "planted",
        "no global variables",
    ),
}

OTHER_PROCESSORS = {
    "software floats": ("-mcpu=cortex-m4 -mthumb -mfloat-abi=soft", "Tag_ABI_VFP_args is not set, not VFP registers"),
    "floats passed in core registers": (
        "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=softfp",
        "Tag_ABI_VFP_args is not set, not VFP registers",
    ),
    "a smaller core": ("-mcpu=cortex-m3 -mthumb", "Tag_CPU_arch is v7, not v7E-M"),
    "a larger core": (
        "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard",
        "Tag_FP_arch is FPv5/FP-D16 for ARMv8, not VFPv4-D16",
    ),
}


def check(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CHECK, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The firmware built for the board."""
    build = tmp_path_factory.mktemp("target")
    for command in (["cmake", "--preset", "target", "-B", build], ["cmake", "--build", build]):
        made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
        assert made.returncode == 0, made.stdout + made.stderr
    return build


@pytest.fixture
def copy(target: Path, tmp_path: Path) -> Path:
    """A copy of the archives to plant something into."""
    for archive in target.glob("*.a"):
        shutil.copy(archive, tmp_path)
    return tmp_path


def plant(folder: Path, source: str, flags: str = FLAGS, archive: str = "libapp.a") -> None:
    """Compile a source and put it into an archive as planted.o."""
    (folder / "planted.c").write_text(source, encoding="utf-8")
    subprocess.run(["arm-none-eabi-gcc", *flags.split(), "-c", "planted.c"], cwd=folder, check=True)
    subprocess.run(["arm-none-eabi-ar", "r", archive, "planted.o"], cwd=folder, check=True)


def failed_lines(result: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in result.stdout.splitlines() if line.startswith("FAIL")]


# The firmware as it is ----------------------------------------------------------------------------------------------


def test_firmware_passes_and_says_how_much_was_looked_at(target: Path) -> None:
    assert HOST_LIBRARY.exists(), "cmake --preset host && cmake --build --preset host"

    result = check(target, "--host", HOST_LIBRARY)

    assert result.returncode == 0, result.stdout + result.stderr
    lines = result.stdout.splitlines()
    assert len(lines) == 7
    for line in lines:
        assert line.startswith("ok   ")
        assert line.endswith("looked at)")
        assert "(0 " not in line


def test_harmless_code_planted_passes(copy: Path) -> None:
    plant(copy, "static const float table[2] = {1.0f, 2.0f}; float f(int i, float x) { return table[i & 1] * x; }")

    result = check(copy)

    assert result.returncode == 0, result.stdout


# Planted violations -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("source", "symbol", "title"), PLANTED.values(), ids=PLANTED)
@pytest.mark.parametrize("archive", ["libcontrol.a", "libprotocol.a", "libapp.a"])
def test_planted_violation_is_named(copy: Path, archive: str, source: str, symbol: str, title: str) -> None:
    plant(copy, source, archive=archive)

    result = check(copy)

    assert result.returncode == 1
    assert any(line.startswith(f"FAIL {title}") for line in failed_lines(result)), result.stdout
    assert any(line.startswith(f"     {archive}(planted.o): {symbol}") for line in result.stdout.splitlines())


@pytest.mark.parametrize(("flags", "finding"), OTHER_PROCESSORS.values(), ids=OTHER_PROCESSORS)
def test_object_for_another_processor_is_named(copy: Path, flags: str, finding: str) -> None:
    plant(copy, "float f(float x) { return x; }", flags=flags)

    result = check(copy)

    assert result.returncode == 1
    assert f"     libapp.a(planted.o): {finding}" in result.stdout.splitlines(), result.stdout


@pytest.mark.parametrize(
    ("source", "finding"),
    [
        ("#include <stdlib.h>\nvoid *f(void) { return malloc(9); }", "no heap in the host's library"),
        ("int planted = 3; int f(void) { return planted++; }", "no global variables in the host's library"),
        ("static int planted; int f(void) { return planted++; }", "no global variables in the host's library"),
    ],
    ids=["malloc", "initialised variable", "zeroed variable"],
)
def test_violation_in_the_hosts_library_is_found(target: Path, tmp_path: Path, source: str, finding: str) -> None:
    (tmp_path / "planted.c").write_text(source, encoding="utf-8")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "planted.so", "planted.c"], cwd=tmp_path, check=True)

    result = check(target, "--host", tmp_path / "planted.so")

    assert result.returncode == 1
    assert [line.partition(" (")[0] for line in failed_lines(result)] == [f"FAIL {finding}"]


# Nothing to look at -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("archive", ["libcontrol.a", "libprotocol.a", "libapp.a"])
def test_missing_archive_fails_and_says_how_to_build_it(copy: Path, archive: str) -> None:
    (copy / archive).unlink()

    result = check(copy)

    assert result.returncode == 1
    assert failed_lines(result) == [f"FAIL no {copy / archive}: cmake --preset target && cmake --build --preset target"]


def test_empty_archive_fails(copy: Path) -> None:
    (copy / "libcontrol.a").write_bytes(b"!<arch>\n")

    result = check(copy)

    assert result.returncode == 1
    assert failed_lines(result) == [f"FAIL {copy / 'libcontrol.a'} holds no object"]


def test_file_that_is_no_archive_fails(copy: Path) -> None:
    (copy / "libcontrol.a").write_text("not an archive", encoding="utf-8")

    result = check(copy)

    assert result.returncode == 1
    assert "libcontrol.a" in result.stderr


def test_missing_host_library_fails(target: Path, tmp_path: Path) -> None:
    result = check(target, "--host", tmp_path / "libomnibot.so")

    assert result.returncode == 1
    assert "cmake --build --preset host" in failed_lines(result)[0]


def test_help_says_what_is_checked() -> None:
    result = check("--help")

    assert result.returncode == 0
    assert "double precision" in result.stdout
