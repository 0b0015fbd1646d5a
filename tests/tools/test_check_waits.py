"""tools/check-waits finds every wait of the board's port, and each kind of loop that might never end."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHECK = ROOT / "tools" / "check-waits"
PORT = ROOT / "firmware" / "ports" / "stm32f405"

BOUND = "#define POLLS WAIT_POLLS(1000, 168)\n"
HARMLESS = {
    "a counting loop over registers": "void f(t *x) { for (uint32_t i = 0; i < 3; i++) { reg_write(&x->r[i], 0); } }",
    "a loop that reaches no register": "int f(int n) { while (n > 1) { n /= 2; } return n; }",
    "a wait with a bound": BOUND + "bool f(t *x) { return wait_until(&x->sr, 1u << 3, g(1, 2), POLLS); }",
    "a loop that a comment speaks of": "// for (;;) { }\nvoid f(void) { /* while (true) {} */ }",
    "a loop in a string": 'const char *f(void) { return "while (reg_read(x)) {"; }',
}
PLANTED = {
    "while over a status": (
        "void f(t *x) { while ((reg_read(&x->sr) & 1u) == 0) { } }",
        "planted.c: f: while ((reg_read(&x->sr) & 1u) == 0) reaches a register and does not count up to a limit",
    ),
    "while without a body": (
        "void f(t *x) { while (reg_read(&x->sr) == 0); }",
        "planted.c: f: while (reg_read(&x->sr) == 0) reaches a register and does not count up to a limit",
    ),
    "do while": (
        "void f(t *x) { uint32_t s; do { s = reg_read(&x->sr); } while (s == 0); }",
        "planted.c: f: do (s == 0) reaches a register and does not count up to a limit",
    ),
    "for without a counter": (
        "void f(t *x) { for (; reg_read(&x->sr) == 0;) { } }",
        "planted.c: f: for (; reg_read(&x->sr) == 0;) reaches a register and does not count up to a limit",
    ),
    "for that counts something else": (
        "void f(t *x) { for (int i = 0; i < 9; g++) { reg_read(&x->sr); } }",
        "planted.c: f: for (int i = 0; i < 9; g++) reaches a register and does not count up to a limit",
    ),
    "for that ends by the status alone": (
        "void f(t *x) { for (int i = 0; reg_read(&x->sr) == 0; i++) { } }",
        "planted.c: f: for (int i = 0; reg_read(&x->sr) == 0; i++) reaches a register and does not count up to a limit",
    ),
    "a register two functions away": (
        "bool g(t *x) { return reg_read(&x->sr); } bool h(t *x) { return g(x); } void f(t *x) { while (!h(x)) { } }",
        "planted.c: f: while (!h(x)) reaches a register and does not count up to a limit",
    ),
    "a wait in a loop": (
        BOUND + "void f(t *x) { while (!wait_until(&x->sr, 1, 1, POLLS)) { } }",
        "planted.c: f: while (!wait_until(&x->sr, 1, 1, POLLS)) reaches a register and does not count up to a limit",
    ),
    "endless for": ("void f(void) { for (;;) { } }", "planted.c: f: for (;;) has no end"),
    "endless while": ("void f(void) { while (true) { } }", "planted.c: f: while (true) has no end"),
    "endless main elsewhere": ("int main(void) { for (;;) { } }", "planted.c: main: for (;;) has no end"),
    "a bound that is a number": (
        "bool f(t *x) { return wait_until(&x->sr, 1, 1, 1000000); }",
        "planted.c: f: wait_until … 1000000: the bound must be a WAIT_POLLS of this file",
    ),
    "a bound that is no WAIT_POLLS": (
        "#define POLLS UINT32_MAX\nbool f(t *x) { return wait_until(&x->sr, 1, 1, POLLS); }",
        "planted.c: f: wait_until … POLLS: the bound must be a WAIT_POLLS of this file",
    ),
    "a register past the functions": (
        "void f(t *x) { x->sr.word = 1; }",
        "planted.c: .word is for reg_read and reg_write alone",
    ),
}


def check(*arguments: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([CHECK, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    """A copy of the port to plant something into."""
    return Path(shutil.copytree(PORT, tmp_path / "port"))


def test_port_waits_for_nothing_without_a_bound() -> None:
    result = check()

    assert result.returncode == 0, result.stdout
    assert result.stdout.splitlines()[-1].startswith("ok   every wait has a bound")
    # as many as there are calls in the sources, counted by other means than the tool's
    calls = sum(path.read_text().count("wait_until(&") for path in PORT.glob("*.c"))
    assert calls > 0
    assert len(result.stdout.splitlines()) == calls + 1


def test_wait_is_listed_with_its_polls_and_time(port: Path) -> None:
    (port / "planted.c").write_text(BOUND + "bool f(t *x) { return wait_until(&x->sr, BIT, BIT, POLLS); }")

    result = check(port)

    assert "planted.c: f: x->sr BIT: 42000 polls, 1000 us or more" in result.stdout.splitlines()


@pytest.mark.parametrize("source", HARMLESS.values(), ids=HARMLESS)
def test_harmless_code_passes(port: Path, source: str) -> None:
    (port / "planted.c").write_text(source)

    assert check(port).returncode == 0, check(port).stdout


@pytest.mark.parametrize(("source", "finding"), PLANTED.values(), ids=PLANTED)
def test_planted_violation_is_named(port: Path, source: str, finding: str) -> None:
    (port / "planted.c").write_text(source)

    result = check(port)

    assert result.returncode == 1
    assert f"     {finding}" in result.stdout.splitlines(), result.stdout


def test_readme_lists_the_waits() -> None:
    assert check("--markdown").stdout in (PORT / "README.md").read_text(encoding="utf-8")


def test_folder_without_loops_fails(tmp_path: Path) -> None:
    assert check(tmp_path).returncode == 1


def test_missing_folder_is_named(tmp_path: Path) -> None:
    result = check(tmp_path / "nowhere")

    assert result.returncode == 1
    assert f"there is no folder {tmp_path / 'nowhere'}" in result.stderr
