"""tools/release: an archive that builds the board's image without Python, and the same bytes each time."""

import hashlib
import os
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RELEASE = ROOT / "tools" / "release"
IMAGE = ROOT / "build" / "target" / "omnibot.bin"
SOMEBODY = {f"GIT_{role}_{what}": "test" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
# All that building the board takes.
TOOLS = ["cmake", "ninja", "sh", *(f"arm-none-eabi-{tool}" for tool in ("gcc", "ar", "ranlib", "objcopy", "size"))]


def git(*arguments: str) -> str:
    environment = {**os.environ, **SOMEBODY}
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture(scope="module")
def commit() -> str:
    """The tracked files as they are now: what is changed becomes a commit of no branch."""
    return git("stash", "create") or git("rev-parse", "HEAD")


def release(folder: Path, commit: str, umask: int = 0o022) -> Path:
    result = subprocess.run(
        [RELEASE, folder, commit], capture_output=True, text=True, check=False, umask=umask, cwd=folder.parent
    )
    assert result.returncode == 0, result.stderr
    return Path(result.stdout.strip())


@pytest.fixture(scope="module")
def archive(commit: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return release(tmp_path_factory.mktemp("release") / "dist", commit)


@pytest.fixture
def tree(archive: Path, tmp_path: Path) -> Path:
    subprocess.run(["tar", "-xzf", archive, "-C", tmp_path], check=True)
    return tmp_path / archive.name.removesuffix(".tar.gz")


def build(tree: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Configure and build the board's image where there is no Python."""
    folder = tree.parent / "bin"
    folder.mkdir(exist_ok=True)
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found is not None
        if not (folder / tool).exists():
            (folder / tool).symlink_to(found)
    assert shutil.which("python3", path=str(folder)) is None
    command = "cmake --preset board && cmake --build --preset board"
    return subprocess.run(
        ["sh", "-c", command, *arguments],
        cwd=tree,
        env={"PATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_unpacked_archive_builds_the_image_of_the_tree_without_python(tree: Path) -> None:
    if not IMAGE.exists():
        pytest.fail(f"there is no {IMAGE}: tools/build target makes it", pytrace=False)
    result = build(tree)
    assert result.returncode == 0, result.stderr
    built = tree / "build" / "board"
    assert (built / "omnibot.bin").read_bytes() == IMAGE.read_bytes()
    assert "OMNIBOT_PYTHON" not in (built / "CMakeCache.txt").read_text()
    for kind in ("elf", "hex", "bin"):
        assert (built / f"omnibot.{kind}").read_bytes() == (tree / "image" / f"omnibot.{kind}").read_bytes()


def test_archive_holds_the_tracked_files_and_what_is_generated(tree: Path, commit: str) -> None:
    held = {str(file.relative_to(tree)) for file in tree.rglob("*") if file.is_file()}
    tracked = set(git("ls-tree", "-r", "--name-only", commit).splitlines())
    generated = {file.name for file in (ROOT / "build" / "target" / "generated").glob("*.[ch]")} - {"board_header.h"}
    assert {"messages.c", "robot_constants.c", "parameter_table.c"} <= generated
    assert held - tracked == {
        "generated/SHA256SUMS",
        *(f"generated/{name}" for name in generated),
        *(f"image/omnibot.{kind}" for kind in ("elf", "hex", "bin")),
    }
    assert tracked <= held
    assert all((tree / name).read_bytes() == (ROOT / name).read_bytes() for name in tracked)


def test_archive_made_again_elsewhere_has_the_same_bytes(archive: Path, commit: str, tmp_path: Path) -> None:
    again = release(tmp_path / "other", commit, umask=0o077)
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(archive.read_bytes()).digest()


def test_archive_tells_nothing_of_who_made_it(archive: Path, commit: str) -> None:
    time = int(git("show", "--no-patch", "--format=%ct", commit))
    with tarfile.open(archive) as file:
        members = file.getmembers()
    assert len(members) > 100
    assert {(member.uid, member.gid, member.uname, member.gname) for member in members} == {(0, 0, "", "")}
    assert {member.mtime for member in members} == {time}
    assert [member.name for member in members] == sorted(member.name for member in members)
    names = b"\0".join(member.name.encode() for member in members)
    assert str(ROOT).encode() not in names


def test_image_holds_no_path_of_the_machine_that_built_it(tree: Path) -> None:
    for kind in ("elf", "hex", "bin"):
        assert b"/tmp/" not in (tree / "image" / f"omnibot.{kind}").read_bytes()


@pytest.mark.parametrize("name", ["protocol/omnibot.dbc", "firmware/robot/omnibot.toml", "tools/generate_codec.py"])
def test_generated_sources_of_a_changed_file_are_refused(tree: Path, name: str) -> None:
    with (tree / name).open("a") as file:
        file.write("\n")
    result = build(tree)
    assert result.returncode != 0
    assert f"{name} was changed" in result.stderr


def test_unknown_commit_and_option_are_refused(tmp_path: Path) -> None:
    for arguments, words in (([tmp_path, "nonesuch"], "no commit nonesuch"), (["--fast"], "no option --fast")):
        result = subprocess.run([RELEASE, *arguments], capture_output=True, text=True, check=False)
        assert result.returncode == 1
        assert words in result.stderr
    assert list(tmp_path.iterdir()) == []
