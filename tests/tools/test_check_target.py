"""tools/check-target: passes the firmware as it is, and finds each thing planted into it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHECK = ROOT / "tools" / "check-target"
LINKER_SCRIPT = ROOT / "firmware" / "ports" / "stm32f405" / "stm32f405.ld"
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
    """A copy of the archives and the image to plant something into."""
    for file in (*target.glob("*.a"), target / "omnibot.elf", target / "omnibot.map"):
        shutil.copy(file, tmp_path)
    return tmp_path


def plant(folder: Path, source: str, flags: str = FLAGS, archive: str = "libapp.a") -> None:
    """Compile a source and put it into an archive as planted.o."""
    (folder / "planted.c").write_text(source, encoding="utf-8")
    subprocess.run(["arm-none-eabi-gcc", *flags.split(), "-c", "planted.c"], cwd=folder, check=True)
    subprocess.run(["arm-none-eabi-ar", "r", archive, "planted.o"], cwd=folder, check=True)


def plant_image(folder: Path, source: str, object_name: str = "planted.o", flags: str = FLAGS) -> None:
    """Link an image of one source, as the board's is linked, in the place of the board's."""
    start = "void reset_handler(void) { f(); }\n"
    (folder / "planted.c").write_text(f"{source}\n{start}", encoding="utf-8")
    gcc = ["arm-none-eabi-gcc", *flags.split()]
    subprocess.run([*gcc, "-c", "planted.c", "-o", object_name], cwd=folder, check=True)
    link = ["-T", LINKER_SCRIPT, "-nostartfiles", "-Wl,--gc-sections", "-Wl,-Map=omnibot.map", "-o", "omnibot.elf"]
    subprocess.run([*gcc, *link, object_name, "-lm"], cwd=folder, check=True)


def failed_lines(result: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in result.stdout.splitlines() if line.startswith("FAIL")]


# The firmware as it is ----------------------------------------------------------------------------------------------


def test_firmware_passes_and_says_how_much_was_looked_at(target: Path) -> None:
    assert HOST_LIBRARY.exists(), "cmake --preset host && cmake --build --preset host"

    result = check(target, "--host", HOST_LIBRARY)

    assert result.returncode == 0, result.stdout + result.stderr
    lines = result.stdout.splitlines()
    assert len(lines) == 10
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


IMAGES = {
    "heap": (
        "#include <stdlib.h>\n#include <stddef.h>\nvoid *_sbrk(ptrdiff_t n) { return (void *)n; }\n"
        "void f(void) { *(volatile char *)malloc(8) = 0; }",
        "planted.o",
        "nothing from outside in the image",
        "omnibot.elf: libc.a(lib_a-malloc.o)",
    ),
    "double precision": (
        "volatile double x; void f(void) { x = x * 1.1; }",
        "main.c.obj",
        "nothing from outside in the image",
        "omnibot.elf: libgcc.a(_arm_muldf3.o)",
    ),
    "maths library": (
        "#include <math.h>\nvolatile float x; void f(void) { x = tanhf(x); }",
        "main.c.obj",
        "nothing from outside in the image",
        "omnibot.elf: libm.a(lib_a-sf_tanh.o)",
    ),
    "semihosting": (
        '__attribute__((noinline)) void g(void) { __asm__ volatile("bkpt 0xab"); } void f(void) { g(); }',
        "planted.o",
        "no call of a debugger in the image",
        "omnibot.elf: g",
    ),
    "supervisor call": (
        '__attribute__((noinline)) void g(void) { __asm__ volatile("svc 0"); } void f(void) { g(); }',
        "planted.o",
        "no call of a debugger in the image",
        "omnibot.elf: g",
    ),
    "zeroed variable": (
        "volatile int x[5]; void f(void) { x[0] = 1; }",
        "planted.o",
        "memory of the image accounted for",
        "omnibot.elf: planted.o: 20 bytes in .bss",
    ),
    "initialised variable in main.c": (
        "volatile int x = 3; void f(void) { x++; }",
        "main.c.obj",
        "memory of the image accounted for",
        "omnibot.elf: main.c: 4 bytes in .data",
    ),
    "variable that outlives a reset": (
        '__attribute__((section(".noinit"))) volatile int x; void f(void) { x++; }',
        "planted.o",
        "memory of the image accounted for",
        "omnibot.elf: planted.o: 4 bytes in .noinit",
    ),
}


@pytest.mark.parametrize(("source", "object_name", "title", "finding"), IMAGES.values(), ids=IMAGES)
def test_planted_violation_in_the_image_is_named(
    copy: Path, source: str, object_name: str, title: str, finding: str
) -> None:
    plant_image(copy, source, object_name)

    result = check(copy)

    assert result.returncode == 1
    assert any(line.startswith(f"FAIL {title}") for line in failed_lines(result)), result.stdout
    assert f"     {finding}" in result.stdout.splitlines(), result.stdout


def test_harmless_image_passes(copy: Path) -> None:
    plant_image(copy, "volatile unsigned long long x = 0, y; void f(void) { x = x / y; }", "main.c.obj")

    result = check(copy)

    assert result.returncode == 0, result.stdout


def test_section_that_no_module_accounts_for_is_named(copy: Path) -> None:
    text = (copy / "omnibot.map").read_text(encoding="utf-8")
    (copy / "omnibot.map").write_text(text.replace(" .bss.loop ", " .gone.loop "), encoding="utf-8")
    lost = check(copy)
    (copy / "omnibot.map").write_text(re.sub(r"(\n \.bss\.loop\s+0x\w+\s+0x\w+)", r"\g<1>0", text), encoding="utf-8")
    grown = check(copy)

    assert lost.returncode == 0  # by whatever name it has bytes there
    assert grown.returncode == 1
    assert re.search(r"omnibot\.elf: \.bss: -\d+ of \d+ bytes belong to no module", grown.stdout), grown.stdout


def test_sizes_add_up_to_the_sections_of_the_image(target: Path) -> None:
    result = check(target, "--sizes")

    total = result.stdout.splitlines()[-1].split()[-2:]
    printed = subprocess.run(
        ["arm-none-eabi-size", "-A", target / "omnibot.elf"], capture_output=True, text=True, check=True
    ).stdout
    size = {line.split()[0]: int(line.split()[1]) for line in printed.splitlines() if line.startswith(".")}
    ram = size[".stack"] + size[".noinit"] + size.get(".data", 0) + size[".bss"]
    flash = sum(size.get(name, 0) for name in (".vectors", ".text", ".rodata", ".ARM.exidx", ".data"))
    assert [int(number) for number in total] == [flash, ram]


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


@pytest.mark.parametrize("file", ["omnibot.elf", "omnibot.map"])
def test_missing_image_fails_and_says_how_to_build_it(copy: Path, file: str) -> None:
    (copy / file).unlink()

    result = check(copy)

    assert result.returncode == 1
    how = "cmake --preset target && cmake --build --preset target"
    assert failed_lines(result) == [f"FAIL no {copy / 'omnibot.elf'} with its map: {how}"]


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
