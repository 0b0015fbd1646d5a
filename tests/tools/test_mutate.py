"""tools/mutate changes what it says it changes, and its gate fails when the tests would not notice."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

CMAKE = """\
cmake_minimum_required(VERSION 3.25)
project(small LANGUAGES C)
set(CMAKE_C_STANDARD 11)
enable_testing()
add_library(small STATIC src/small.c)
target_include_directories(small PUBLIC src)
add_subdirectory(tests/unit)
"""
UNIT_CMAKE = """\
add_executable(test_small test_small.c)
target_link_libraries(test_small PRIVATE small)
add_test(NAME small COMMAND test_small)
"""
SOURCE = """\
#include "small.h"

static const int weight[2] = {3, 5};

int weighed(int a, int b)
{
    return weight[0] * a + weight[1] * b;
}

int larger(int a, int b)
{
    return a > b ? a : b;
}

int counted(int n)
{
    int sum = 0;
    for (int i = 0; i < n; i++) {
        sum += i + 3;
    }
    return sum;
}

unsigned unchanged(unsigned a)
{
    return a + 0u;
}
"""
HEADER = "int weighed(int a, int b);\nint larger(int a, int b);\nint counted(int n);\nunsigned unchanged(unsigned a);\n"
ASSERTING = """\
#include "small.h"

int main(void)
{
    int good = weighed(1, 10) == 53 && weighed(2, -1) == 1 && larger(1, 2) == 2 && larger(2, 1) == 2;
    good = good && counted(4) == 18 && counted(0) == 0 && unchanged(7u) == 7u;
    return good ? 0 : 1;
}
"""
CALLING = """\
#include "small.h"

int main(void)
{
    (void)(larger(1, 2) + (int)unchanged(7u));
    return 0;
}
"""
BOUNDARY = """\
[[argued]]
file = "src/small.c"
function = "larger"
line = "return a > b ? a : b;"
mutants = ["return a >= b ? a : b;"]
reason = "the larger of two equal numbers is either"
"""


def make(root: Path, source: str = SOURCE, test: str = ASSERTING, argued: str = "", header: str = HEADER) -> Path:
    """Write a small project."""
    for name, text in {
        "CMakeLists.txt": CMAKE,
        ".gitignore": "build/\n",
        "src/small.c": source,
        "src/small.h": header,
        "tests/unit/CMakeLists.txt": UNIT_CMAKE,
        "tests/unit/test_small.c": test,
        "tests/mutation/survivors.toml": argued,
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "--quiet"], cwd=root, check=True)
    return root


def mutate(root: Path, *arguments: object, path: str = "src") -> "subprocess.CompletedProcess[str]":
    command = [ROOT / "tools" / "mutate", "--root", root, root / path, *arguments]
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, timeout=300)


def result(root: Path, *arguments: object) -> tuple[int, dict[str, Any]]:
    done = mutate(root, "--json", *arguments)
    assert done.stdout, done.stderr
    shown: dict[str, Any] = json.loads(done.stdout)
    return done.returncode, shown


def outcome(shown: dict[str, Any], mutant: str) -> str:
    found = [m["outcome"] for m in shown["mutants"] if m["mutant"] == mutant]
    assert len(found) == 1, mutant
    return str(found[0])


# ---- what becomes of mutants


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, dict[str, Any]]:
    """Everything of the small project, whose tests notice all but what they cannot."""
    return result(make(tmp_path_factory.mktemp("tried"), argued=BOUNDARY))


@pytest.mark.parametrize(
    "mutant",
    [
        "return weight[0] * a - weight[1] * b;",
        "return weight[0] / a + weight[1] * b;",
        "return weight[1] * a + weight[1] * b;",
        "return a <= b ? a : b;",
        "int sum = 1;",
        "(void)0;",
        "return 0;",
    ],
)
def test_mutant_that_a_test_notices_is_killed(tried: tuple[int, dict[str, Any]], mutant: str) -> None:
    found = {m["outcome"] for m in tried[1]["mutants"] if m["mutant"] == mutant}
    assert found == {"failed"}


def test_mutant_in_a_table_that_the_compiler_must_know_is_killed(tried: tuple[int, dict[str, Any]]) -> None:
    for numbers in ("{2, 5}", "{4, 5}", "{3, 4}", "{3, 6}"):
        assert outcome(tried[1], f"static const int weight[2] = {numbers};") == "failed"


def test_mutant_without_end_is_killed(tried: tuple[int, dict[str, Any]]) -> None:
    assert outcome(tried[1], "for (int i = 0; i < n; i--) {") in {"timeout", "crashed", "failed"}


def test_mutant_past_an_array_is_killed(tried: tuple[int, dict[str, Any]]) -> None:
    assert outcome(tried[1], "return weight[0] * a + weight[2] * b;") in {"failed", "crashed"}


def test_mutant_of_the_same_machine_code_is_no_mutant(tried: tuple[int, dict[str, Any]]) -> None:
    assert outcome(tried[1], "return a - 0u;") == "equivalent"


def test_argued_survivor_passes_and_still_counts(tried: tuple[int, dict[str, Any]]) -> None:
    status, shown = tried
    alive = [m for m in shown["mutants"] if m["outcome"] == "survived"]
    same = [m for m in shown["mutants"] if m["outcome"] == "equivalent"]

    assert (status, shown["wrong"]) == (0, [])
    assert [m["mutant"] for m in alive] == ["return a >= b ? a : b;"]
    assert alive[0]["at"] == 12
    assert alive[0]["reason"] == "the larger of two equal numbers is either"
    assert shown["score"] == pytest.approx(1.0 - 1.0 / (len(shown["mutants"]) - len(same)))


def test_endless_loop_is_ended(tmp_path: Path) -> None:
    source = "unsigned f(unsigned n)\n{\n    while (n > 3u) {\n        n -= 3u;\n    }\n    return n;\n}\n"
    test = "unsigned f(unsigned n);\nint main(void) { return f(7u) == 1u && f(6u) == 3u ? 0 : 1; }\n"
    shown = result(make(tmp_path, source, test, header=""))[1]
    assert outcome(shown, "(void)0;") == "timeout"


# ---- the gate


def test_tests_without_assertions_score_nothing(tmp_path: Path) -> None:
    done, shown = result(make(tmp_path, test=CALLING, argued=BOUNDARY))
    assert done == 1
    assert shown["score"] == 0.0
    assert f"the score of {tmp_path / 'src'} is 0.0 %, below 90 %" in shown["wrong"]


def test_survivor_that_is_not_argued_fails_and_is_shown_with_its_place(tmp_path: Path) -> None:
    done = mutate(make(tmp_path))
    assert done.returncode == 1
    assert "mutate: 1 survivors are not argued in tests/mutation/survivors.toml" in done.stderr
    assert (
        "src/small.c:12: larger: SURVIVED: relational\n    return a > b ? a : b;\n    return a >= b ? a : b;\n"
        in done.stdout
    )


def test_argued_survivor_that_is_killed_fails(tmp_path: Path) -> None:
    killed = BOUNDARY.replace('["return', '["return a <= b ? a : b;", "return')
    done = mutate(make(tmp_path, argued=killed))
    assert done.returncode == 1
    assert (
        "mutate: argued survivor, src/small.c: larger: is failed, not survived: return a > b ? a : b; -> "
        "return a <= b ? a : b;" in done.stderr
    )


def test_argued_survivor_that_is_gone_fails_even_in_a_sample(tmp_path: Path) -> None:
    gone = BOUNDARY.replace('["return', '["return a == b ? a : b;", "return')
    done = mutate(make(tmp_path, argued=gone), "--sample", 1)
    assert done.returncode == 1
    assert "argued survivor, src/small.c: larger: no such mutant: return a > b ? a : b; -> return a == b ? a : b;" in (
        done.stderr
    )


def test_sample_is_the_same_for_the_same_seed(tmp_path: Path) -> None:
    make(tmp_path, argued=BOUNDARY)
    picked = [
        [m["mutant"] for m in result(tmp_path, "--sample", 5, "--seed", seed)[1]["mutants"]] for seed in (1, 1, 2)
    ]
    assert len(picked[0]) == 5
    assert picked[0] == picked[1] != picked[2]


def test_tests_that_fail_anyway_are_an_error(tmp_path: Path) -> None:
    done = mutate(make(tmp_path, test=ASSERTING.replace("== 53", "== 54")))
    assert done.returncode == 2
    assert "mutate: test small fails on the sources as they are" in done.stderr


# ---- which mutants there are

CHANGES = {
    "sign of a product": ("float f(float a, float b) { float c = a * b; return c; }", {"a / b", "-(a * b)"}),
    "sign of a sum": (
        "float f(float a, float b) { float c = a - b * a; return c; }",
        {"a + b * a", "a - b / a"},
    ),
    "sign": ("float f(float a) { float c = -a; return c; }", {"a;"}),
    "logical": ("_Bool f(int a, int b) { _Bool c = a && b; return c; }", {"(a || b)"}),
    "negated": ("_Bool f(int a) { _Bool c = !a; return c; }", {"c = a;"}),
    "condition": ("int f(int a, int b) { int c = a ? a : b; return c; }", {"!(a) ? a : b"}),
    "equality": ("_Bool f(int a, int b) { _Bool c = a == b; return c; }", {"a != b"}),
    "limits": ("_Bool f(int a, int b) { _Bool c = a <= b; return c; }", {"a < b", "a > b"}),
    "bits": ("unsigned f(unsigned a) { unsigned c = ~(a << a); return c; }", {"c = (a << a)", "~((a >> a))"}),
    "float": ("float f(void) { float c = 0.5f; return c; }", {"c = (2 * 0.5f)", "c = (-0.5f)"}),
    "float zero": ("float f(void) { float c = 0.0f; return c; }", {"c = 1.0f"}),
    "hexadecimal": ("unsigned f(void) { unsigned c = 0x10u; return c; }", {"c = 0xfu", "c = 0x11u"}),
    "named": ("enum { N = 4 };\nint f(void) { int c = N; return c; }", {"c = (N + 1)", "c = (N - 1)"}),
    "macro": ("#define N 4\nint f(void) { int c = N; return c; }", {"c = (N + 1)", "c = (N - 1)"}),
    "index": ("int f(int *a, int i) { int c = a[i]; return c; }", {"a[(i) + 1]", "a[(i) - 1]"}),
    "assignment": ("void f(int *a, int b) { *a = b; }", {"{ (void)0; }"}),
    "compound": ("void f(int *a, int b) { *a += b; }", {"{ (void)0; }", "*a -= b"}),
    "call": ("void g(void);\nvoid f(void) { g(); }", {"{ (void)0; }"}),
    "truth returned": ("_Bool f(_Bool a) { return a; }", {"return !(a)"}),
    "float returned": ("float f(float a) { return a; }", {"return 0.0f", "return -(a)"}),
    "number returned": ("int f(int a) { return a; }", {"return 0", "return (a) + 1"}),
    "struct returned": ("typedef struct { int a; } s;\ns f(s a) { return a; }", {"return (s){0}"}),
    "what only the compiler reads": ('enum { N = 4 };\nint a[N];\n_Static_assert(N == 4, "");', set()),
}


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """What the tool lists of a project with one file for each of them."""
    root = make(tmp_path_factory.mktemp("listed"))
    files = [f"src/{case.replace(' ', '_')}.c" for case in CHANGES]
    for file, (source, _) in zip(files, CHANGES.values(), strict=True):
        (root / file).write_text(source + "\n", encoding="utf-8")
    (root / "CMakeLists.txt").write_text(CMAKE.replace("src/small.c", f"src/small.c {' '.join(files)}"))
    lines = mutate(root, "--list").stdout.splitlines()
    return {
        case: [line.split(" -> ")[1] for line in lines if line.startswith(f"{file}:")]
        for case, file in zip(CHANGES, files, strict=True)
    }


@pytest.mark.parametrize("case", CHANGES)
def test_mutants_of_a_source_are_those_that_are_expected(listed: dict[str, list[str]], case: str) -> None:
    source, changes = CHANGES[case]
    of_return = 0 if "return c" not in source else 1 if "_Bool" in source else 2
    assert {c for c in changes if any(c in mutant for mutant in listed[case])} == changes
    assert len(listed[case]) == len(changes) + of_return


# ---- what a user may get wrong


def test_path_without_any_source_is_named(tmp_path: Path) -> None:
    done = mutate(make(tmp_path), path="nowhere")
    assert done.returncode == 2
    assert done.stderr == f"mutate: {tmp_path / 'nowhere'} is no C file of the project, and no folder with one\n"


@pytest.mark.parametrize("option", ["--sample", "--jobs"])
def test_count_that_is_none_is_named(tmp_path: Path, option: str) -> None:
    done = mutate(tmp_path, option, "0")
    assert done.returncode == 2
    assert f"{option} is a whole number above 0, not 0" in done.stderr


@pytest.mark.parametrize(
    ("argued", "message"),
    [
        ("[[argued]\n", "survivors.toml: "),
        (BOUNDARY.replace("reason", "because"), "argued survivor 1 has no reason; it needs file, function, line"),
        (BOUNDARY + 'why = "?"\n', "argued survivor 1 has an unknown why"),
    ],
)
def test_argument_that_cannot_be_read_is_named(tmp_path: Path, argued: str, message: str) -> None:
    done = mutate(make(tmp_path, argued=argued))
    assert done.returncode == 2
    assert message in done.stderr
