"""tools/with-vcan runs a command as if it had been run directly, except that vcan0 is there."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

WITH_VCAN = Path(__file__).parents[2] / "tools" / "with-vcan"
TIMEOUT_S = 30


def run(*command, **options):
    return subprocess.run([WITH_VCAN, "--", *command], capture_output=True, timeout=TIMEOUT_S, check=False, **options)


def descendants(pid):
    """Process ids of the children of `pid`, and of theirs; none of a process that has ended meanwhile."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [found for child in children for found in (int(child), *descendants(child))]


def command_line(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def is_alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.mark.parametrize("status", [0, 3])
def test_exit_status_is_the_commands(status):
    assert run("sh", "-c", f"exit {status}").returncode == status


def test_command_ended_by_a_signal_gives_128_and_its_number():
    assert run("sh", "-c", "kill -KILL $$").returncode in {128 + signal.SIGKILL, -signal.SIGKILL}


def test_unknown_command_gives_127():
    assert run("no-such-command").returncode == 127


def test_vcan0_is_up_and_carries_a_frame():
    exchange = """
import socket
sender, receiver = (socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) for _ in range(2))
for end in (sender, receiver):
    end.bind(("vcan0",))
receiver.settimeout(5)
sender.send(bytes.fromhex("23010000 08000000 0011223344556677"))
print(receiver.recv(16).hex())
"""
    assert run(sys.executable, "-c", exchange).stdout == b"23010000080000000011223344556677\n"


def test_output_streams_are_apart_and_binary_safe(tmp_path):
    out, err = tmp_path / "out", tmp_path / "err"
    out.write_bytes(bytes(range(256)) * 4096)  # 1 MB of every byte: no newline, control or flow-control byte is touched
    err.write_bytes(bytes(reversed(range(256))) * 400)
    result = run("sh", "-c", 'cat "$1"; cat "$2" >&2', "sh", out, err)
    assert result.stdout == out.read_bytes()
    announcement, _, rest = result.stderr.partition(b"\n")
    assert announcement.startswith(b"with-vcan: vcan0 ")
    assert rest == err.read_bytes()


def test_arguments_arrive_unchanged():
    arguments = ["a b", "'\"`$HOME\\", "two\nlines", "", "*", "A=b", "--", "-x", "größe"]
    result = run("printf", "%s\\0", *arguments)
    assert result.stdout.decode().split("\0") == [*arguments, ""]


def test_environment_and_folder_are_the_callers(tmp_path):
    folder = tmp_path / "with space 'and' quote"
    folder.mkdir()
    variables = {**os.environ, "VIRTUAL_ENV": "/a b", "CI": "line\nbreak 'quoted' $HOME"}
    result = run("sh", "-c", 'printf "%s\\0" "$PWD" "$VIRTUAL_ENV" "$CI" "$PATH"', cwd=folder, env=variables)
    expected = [str(folder), variables["VIRTUAL_ENV"], variables["CI"], variables["PATH"], ""]
    assert result.stdout.decode().split("\0") == expected


def test_files_are_shared_both_ways(tmp_path):
    (tmp_path / "in").write_text("from outside\n")
    run("sh", "-c", "cat in >out; echo 'and inside' >>out", cwd=tmp_path)
    assert (tmp_path / "out").read_text() == "from outside\nand inside\n"


def test_sigterm_leaves_no_process_and_no_folder():
    wrapper = subprocess.Popen(
        [WITH_VCAN, "--", "sh", "-c", "echo ready; exec sleep 1000"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert wrapper.stdout.readline() == b"ready\n"
    family = descendants(wrapper.pid)
    commands = "".join(command_line(pid) for pid in family)
    folders = set(re.findall(r"init=(/tmp/with-vcan\.\w+)/init", commands))

    wrapper.send_signal(signal.SIGTERM)
    status = wrapper.wait(timeout=TIMEOUT_S)
    wrapper.communicate(timeout=TIMEOUT_S)  # returns once nobody holds its output open

    assert status in {128 + signal.SIGTERM, -signal.SIGTERM}
    assert [pid for pid in family if is_alive(pid)] == []
    assert [folder for folder in folders if Path(folder).exists()] == []


def test_output_that_is_closed_ends_the_command():
    wrapper = subprocess.Popen([WITH_VCAN, "--", "yes"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert wrapper.stdout.readline() == b"y\n"
    wrapper.stdout.close()
    assert wrapper.wait(timeout=TIMEOUT_S) in {128 + signal.SIGPIPE, -signal.SIGPIPE}


@pytest.mark.parametrize("arguments", [[], ["--"], ["true"]])
def test_wrong_usage_is_told_in_one_line(arguments):
    result = subprocess.run([WITH_VCAN, *arguments], capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert result.returncode == 125
    assert re.fullmatch(r"with-vcan: .*say: tools/with-vcan -- COMMAND.*\n", result.stderr)
