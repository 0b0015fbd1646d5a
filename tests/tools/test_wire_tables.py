"""protocol/README.md says what is on the wire: its tables are those of the DBC, its examples those of the firmware."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import can
import cantools.database
import pytest

from host_sim.codec import DBC_FILE, Codec
from host_sim.inproc import LIBRARY_FILE, InprocBus

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "generate_wire_tables.py"
README = ROOT / "protocol" / "README.md"
DBC = ROOT / "protocol" / "omnibot.dbc"
FAULTS = ROOT / "firmware" / "app" / "faults.toml"
DATABASE = cantools.database.load_file(DBC_FILE)
CODEC = Codec()


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate_wire_tables", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def copy(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the DBC and the README."""
    shutil.copy(DBC_FILE, tmp_path)
    shutil.copy(README, tmp_path)
    return tmp_path / DBC_FILE.name, tmp_path / README.name


def generate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(TOOL), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


# Tables -------------------------------------------------------------------------------------------------------------


def test_tables_of_the_readme_are_those_of_the_definition() -> None:
    result = generate(DBC_FILE, README, "--check")

    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("old", "new"),
    [("(0.0005,0)", "(0.001,0)"), ("Asks for a change", "Begs for a change"), ('1 "START"', '1 "GO"')],
)
def test_tables_are_stale_after_a_change_of_the_definition_until_made_again(
    copy: tuple[Path, Path], old: str, new: str
) -> None:
    dbc, readme = copy
    dbc.write_text(dbc.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    before = readme.read_text(encoding="utf-8")

    stale = generate(dbc, readme, "--check")

    assert stale.returncode == 1
    assert "stale; tools/generate_wire_tables.py" in stale.stderr
    assert readme.read_text(encoding="utf-8") == before
    assert generate(dbc, readme).returncode == 0
    assert generate(dbc, readme, "--check").returncode == 0


def test_message_without_a_table_is_named(copy: tuple[Path, Path]) -> None:
    dbc, readme = copy
    readme.write_text(readme.read_text(encoding="utf-8").replace("<!-- wire: SLIP -->", ""), encoding="utf-8")

    result = generate(dbc, readme, "--check")

    assert result.returncode == 1
    assert "do not belong together: SLIP" in result.stderr


def test_table_without_a_message_is_named(copy: tuple[Path, Path]) -> None:
    dbc, readme = copy
    readme.write_text(readme.read_text(encoding="utf-8") + "\n<!-- wire: GONE -->\n<!-- end -->\n", encoding="utf-8")

    assert "do not belong together: GONE" in generate(dbc, readme).stderr


def test_every_identifier_of_the_readme_is_the_definitions() -> None:
    rows = re.findall(r"^\| 0x([0-9A-F]{3}) \| (\w+) \|", README.read_text(encoding="utf-8"), re.MULTILINE)

    assert {name: int(identifier, 16) for identifier, name in rows} == {m.name: m.frame_id for m in DATABASE.messages}
    assert rows == sorted(rows)  # the order of priority


# Faults ---------------------------------------------------------------------------------------------------------------


def generate_faults(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, ROOT / "tools" / "generate_faults.py", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_fault_table_of_the_readme_is_that_of_the_faults() -> None:
    done = generate_faults(FAULTS, DBC, README, "--check")
    assert (done.returncode, done.stderr) == (0, "")


def test_changed_fault_makes_the_readmes_table_stale(tmp_path: Path) -> None:
    changed = tmp_path / "faults.toml"
    changed.write_text(FAULTS.read_text(encoding="utf-8").replace("ticks = 501", "ticks = 502"), encoding="utf-8")
    assert "its table is not that of the faults" in generate_faults(changed, DBC, README, "--check").stderr


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "OVERRUN"', 'name = "OVERRAN"', "the faults must be those of STATUS.fault"),
        ('reaction = "cut"', 'reaction = "sulk"', "reaction 'sulk' must be one of brake, cut"),
    ],
)
def test_faults_that_are_not_the_wires_are_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    changed = tmp_path / "faults.toml"
    changed.write_text(FAULTS.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    done = generate_faults(changed, DBC, tmp_path)
    assert done.returncode == 1
    assert says in done.stderr


# Examples -----------------------------------------------------------------------------------------------------------


def session() -> list[tuple[int, bytes]]:
    """The frames of the README's session."""
    lines = re.findall(
        r"^\(\d+\.\d{6}\) vcan0 ([0-9A-F]{3})#([0-9A-F]*)", README.read_text(encoding="utf-8"), re.MULTILINE
    )
    return [(int(identifier, 16), bytes.fromhex(data)) for identifier, data in lines]


def comparable(identifier: int, data: bytes) -> tuple[str, object]:
    """What of a frame does not depend on the definition's hash, the robot file or the controller's gains."""
    message = CODEC.of_id(identifier)
    assert message is not None
    values = message.named(data)
    if message.name in ("HELLO", "IDENTITY"):
        values.pop("protocol_hash")
    if message.name == "PARAMETER_STORE":
        values.pop("robot_checksum")
    if message.name in ("TORQUE", "SLIP"):
        values = {name: value for name, value in values.items() if name in ("counter", "mode")}
    return message.name, values


def test_session_of_the_readme_is_what_the_firmware_says() -> None:
    assert LIBRARY_FILE.exists(), "cmake --preset host && cmake --build --preset host"
    from_host = {CODEC[m.name].arbitration_id for m in DATABASE.messages if m.senders == ["HOST"]}
    frames = session()
    assert len(frames) > 40
    answers = []

    with InprocBus() as bus:
        for identifier, data in frames:
            if identifier not in from_host:
                answer = bus.recv(0.0)
                assert answer is not None, (hex(identifier), data.hex())
                answers.append((answer.arbitration_id, bytes(answer.data)))
            elif CODEC.of_id(identifier) is CODEC["HELLO"]:
                hello = CODEC["HELLO"].pack(CODEC.protocol_hash)
                bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=hello))
            else:
                bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
        assert bus.recv(0.0) is None

    told = [comparable(*frame) for frame in frames if frame[0] not in from_host]
    assert [comparable(*answer) for answer in answers] == told


def test_crc_example_of_the_readme_is_right() -> None:
    frame = re.search(r"the frame is 040#([0-9A-F]{14})", README.read_text(encoding="utf-8"))
    assert frame

    assert CODEC["SYNC"].named(bytes.fromhex(frame[1])) == {
        "tick": 0x12345678,
        "pose_crc": 0x9A,
        "wheel_speed_crc": 0xBC,
    }
