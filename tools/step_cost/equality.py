"""Target and host, bit for bit: the target's instructions on the emulated processor beside the host's libraries.

Three comparisons over the corpus. Every frame that comes out is the same, byte for byte; so is the firmware's whole
memory behind every group of frames, field for field; and so is everything that control_step returns and leaves in its
state, given the inputs that it had on the target. A fourth asks the trigonometry at random angles.

The two lay their structs out differently (pointers, the size of enumerations): fields are found by DWARF.
"""

import ctypes
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import unicorn
from numpy.typing import NDArray
from unicorn import arm_const as arm

from host_sim.inproc import Frame, load_firmware
from step_cost.calls import calls_of
from step_cost.corpus import NODE, FrameIn, Session
from step_cost.errors import CostError
from step_cost.image import Image
from step_cost.layout import Layout, layouts
from step_cost.machine import INSTANCE
from step_cost.measure import Target

CONTROL = ("control_params_t", "control_state_t", "control_input_t", "control_output_t")
ANGLE_MAX_rad = 100.0
PATIENCE = 5  # differences listed


class DifferenceError(CostError):
    """Target and host are not the same."""


@dataclass
class Compared:
    """How much was found to be the same."""

    frames: int = 0
    groups: int = 0
    control_steps: int = 0
    angles: int = 0


# ---- structs of two worlds


class Translation:
    """Between a struct of the target and the same one of the host; pointers are left out."""

    def __init__(self, target: Layout, host: Layout) -> None:
        names = [leaf.name for leaf in target.leaves]
        if names != [leaf.name for leaf in host.leaves]:
            raise DifferenceError(
                f"{target.name} has other fields on the host: was the host build made from this source?"
            )
        pairs = [(t, h) for t, h in zip(target.leaves, host.leaves, strict=True) if not t.pointer]
        self.sizes = (target.size, host.size)
        self._names = [t.name for t, h in pairs for _ in range(min(t.size, h.size))]
        self._target = _places((t.offset, min(t.size, h.size)) for t, h in pairs)
        self._host = _places((h.offset, min(t.size, h.size)) for t, h in pairs)

    def to_host(self, memory: bytes) -> bytearray:
        """Return the host's struct with the values of the target's."""
        made = np.zeros(self.sizes[1], np.uint8)
        made[self._host] = np.frombuffer(memory, np.uint8)[self._target]
        return bytearray(made.tobytes())

    def differences(self, target: bytes, host: bytes) -> list[str]:
        """Return the fields whose bits differ."""
        ours = np.frombuffer(target, np.uint8)[self._target]
        theirs = np.frombuffer(host, np.uint8)[self._host]
        return sorted({self._names[place] for place in np.flatnonzero(ours != theirs)})


def _places(pieces: Iterable[tuple[int, int]]) -> NDArray[np.intp]:
    return np.array([offset + i for offset, size in pieces for i in range(size)], np.intp)


# ---- the host's side


class Host:
    """The firmware of libomnibot.so, with the calls of Target."""

    def __init__(self, library: Path) -> None:
        self._library = load_firmware(library)
        self._size = self._library.omnibot_size()
        self._memory = (ctypes.c_uint64 * (self._size // 8 + 1))()
        self._address = ctypes.addressof(self._memory)
        self._library.omnibot_init(self._address, NODE)

    def exchange(self, frames: Iterable[FrameIn]) -> list[FrameIn]:
        """Give frames to the firmware, take its answers out until there are none, and return them."""
        frame = Frame()
        for identifier, data in frames:
            frame.id, frame.length = identifier, len(data)
            ctypes.memmove(frame.data, data.ljust(8, b"\0"), 8)
            self._library.omnibot_receive(self._address, ctypes.byref(frame))
        answers = []
        while self._library.omnibot_transmit(self._address, ctypes.byref(frame)):
            answers.append(FrameIn(frame.id, bytes(frame.data[: frame.length])))
        return answers

    def memory(self) -> bytes:
        """Return the instance as it is."""
        return ctypes.string_at(self._address, self._size)


class HostControl:
    """control_step and the trigonometry of libcontrol-visible.so."""

    def __init__(self, library: Path, target: Image) -> None:
        self._library = ctypes.CDLL(str(library))
        ours, theirs = layouts(target.file), layouts(library)
        self.translations = {name: Translation(ours[name], theirs[name]) for name in CONTROL}
        robot = ctypes.addressof(ctypes.c_byte.in_dll(self._library, "omnibot"))
        self._check_robot(target, robot, Translation(ours["robot_t"], theirs["robot_t"]))
        self._pointers = _pointers(theirs, robot)
        self._target_pointers = _pointers(ours, target.objects["omnibot"][0])
        self._library.control_step.restype = ctypes.c_bool

    @staticmethod
    def _check_robot(target: Image, robot: int, translation: Translation) -> None:
        address, size = target.objects["omnibot"]
        host = ctypes.string_at(robot, translation.sizes[1])
        differing = translation.differences(target.data(address, size), host)
        if differing:
            raise DifferenceError(f"the robot's constants differ: {', '.join(differing[:PATIENCE])}")

    def step(self, captured: "CapturedStep") -> list[str]:
        """Do on the host what was done on the target, and return what came out differently."""
        for offset, value in self._target_pointers.items():
            if struct.unpack_from("<I", captured.params, offset)[0] != value:
                return [f"the pointer at byte {offset} of the parameters, which is not to the robot's constants"]
        params = self.translations["control_params_t"].to_host(captured.params)
        for offset, value in self._pointers.items():
            struct.pack_into("<Q", params, offset, value)
        state = self.translations["control_state_t"].to_host(captured.state_before)
        given = self.translations["control_input_t"].to_host(captured.input)
        output = bytearray(self.translations["control_output_t"].sizes[1])
        result = self._library.control_step(*(_buffer(memory) for memory in (params, state, given, output)))
        found = ["the value returned"] if result != captured.result else []
        found += self.translations["control_state_t"].differences(captured.state_after, bytes(state))
        return found + self.translations["control_output_t"].differences(captured.output, bytes(output))

    def rotation(self, angle_bits: int) -> tuple[int, int]:
        """Return the bits of cosine and sine."""

        class Rotation(ctypes.Structure):
            _fields_ = (("cosine", ctypes.c_float), ("sine", ctypes.c_float))

        function = self._library.rotation_of
        function.argtypes, function.restype = (ctypes.c_float,), Rotation
        made = function(_float(angle_bits))
        return _bits(made.cosine), _bits(made.sine)

    def wrapped(self, angle_bits: int) -> int:
        """Return the bits of the wrapped angle."""
        function = self._library.angle_wrap
        function.argtypes, function.restype = (ctypes.c_float,), ctypes.c_float
        return _bits(function(_float(angle_bits)))


def _pointers(structs: dict[str, Layout], robot: int) -> dict[int, int]:
    """Return what each pointer of control_params_t, by its offset, holds where the robot's constants lie there."""
    params = structs["control_params_t"]
    known = {"robot": robot, "floor.curve": robot + structs["robot_t"].offset_of("floor_curve")}
    names = [leaf.name for leaf in params.leaves if leaf.pointer]
    if sorted(names) != sorted(known):
        raise DifferenceError(f"control_params_t holds the pointers {', '.join(names)}; known are {', '.join(known)}")
    return {params[name].offset: value for name, value in known.items()}


def _buffer(memory: bytearray) -> ctypes.Array[ctypes.c_char]:
    return (ctypes.c_char * len(memory)).from_buffer(memory)


def _float(bits: int) -> float:
    return float(struct.unpack("<f", bits.to_bytes(4, "little"))[0])


def _bits(value: float) -> int:
    return int.from_bytes(struct.pack("<f", value), "little")


# ---- the target's side


@dataclass
class CapturedStep:
    """One control_step on the target: memory before and behind it."""

    params: bytes
    state_before: bytes
    input: bytes
    addresses: tuple[int, int]  # of state and output
    state_after: bytes = b""
    output: bytes = b""
    result: bool = False


class Captures:
    """Keeps the inputs and results of every control_step that the emulated firmware makes."""

    def __init__(self, target: Target) -> None:
        self._uc = target.machine.emulator
        self._sizes = {name: layouts(target.image.file)[name].size for name in CONTROL}
        self.steps: list[CapturedStep] = []
        entry = target.image.function("control_step")
        functions = calls_of(target.image).values()
        returns = [back for function in functions for back, called in function.calls if called == "control_step"]
        self._uc.hook_add(unicorn.UC_HOOK_CODE, self._enter, begin=entry, end=entry)
        for back in returns:
            self._uc.hook_add(unicorn.UC_HOOK_CODE, self._leave, begin=back, end=back)

    def _read(self, address: int, name: str) -> bytes:
        return bytes(self._uc.mem_read(address, self._sizes[name]))

    def _enter(self, uc: unicorn.Uc, _address: int, _size: int, _data: object) -> None:
        registers = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)
        params, state, given, output = (uc.reg_read(register) for register in registers)
        self.steps.append(
            CapturedStep(
                params=self._read(params, "control_params_t"),
                state_before=self._read(state, "control_state_t"),
                input=self._read(given, "control_input_t"),
                addresses=(state, output),
            )
        )

    def _leave(self, uc: unicorn.Uc, _address: int, _size: int, _data: object) -> None:
        step = self.steps[-1]
        state, output = step.addresses
        step.state_after = self._read(state, "control_state_t")
        step.output = self._read(output, "control_output_t")
        step.result = bool(uc.reg_read(arm.UC_ARM_REG_R0) & 0xFF)


# ---- the comparisons


class Equality:
    """Runs sessions on both sides and raises DifferenceError where they part.

    Parameters
    ----------
    image
        The measuring image.
    host
        The host build's folder: libomnibot.so and libcontrol-visible.so.
    """

    def __init__(self, image: Image, host: Path) -> None:
        self.compared = Compared()
        self.target, self._library = Target(image), host / "libomnibot.so"
        self.captures = Captures(self.target)
        self._control = HostControl(host / "libcontrol-visible.so", image)
        self._app = Translation(layouts(image.file)["app_t"], layouts(self._library)["app_t"])

    def session(self, session: Session) -> None:
        """Compare one session."""
        host = Host(self._library)
        self.target.start(NODE)
        for number, group in enumerate(session.groups):
            where = f"{session.name}, group {number} ({group.kind})"
            self.captures.steps.clear()
            ours, theirs = self.target.exchange(group.frames), host.exchange(group.frames)
            if ours != theirs:
                raise DifferenceError(f"{where}: the target answers {_shown(ours)}, the host {_shown(theirs)}")
            memory = self.target.machine.read(INSTANCE, self._app.sizes[0])
            _refuse(f"{where}: app_t", self._app.differences(memory, host.memory()))
            for step in self.captures.steps:
                _refuse(f"{where}: control_step", self._control.step(step))
            self.compared.frames += len(ours)
            self.compared.groups += 1
            self.compared.control_steps += len(self.captures.steps)

    def trigonometry(self, angles: int, rng: np.random.Generator) -> None:
        """Compare rotation_of and angle_wrap at random angles."""
        machine, image = self.target.machine, self.target.image
        rotation, wrap = image.function("rotation_of"), image.function("angle_wrap")
        for bits in angle_bits(angles, rng):
            machine.call_with_floats(rotation, (bits,))
            ours = (*machine.float_results(2),)
            machine.call_with_floats(wrap, (bits,))
            ours = (*ours, *machine.float_results(1))
            theirs = (*self._control.rotation(bits), self._control.wrapped(bits))
            if ours != theirs:
                raise DifferenceError(f"angle {_float(bits)!r}: the target makes {ours} of it, the host {theirs}")
            self.compared.angles += 1


def angle_bits(count: int, rng: np.random.Generator) -> Iterator[int]:
    """Yield angles within the contract of rotation_of: of any size from subnormal up, and at the joints of quarters."""
    yield from (_bits(angle) for angle in (0.0, -0.0, 1e-45, -1e-40, ANGLE_MAX_rad, -ANGLE_MAX_rad))
    quarters = np.arange(-63, 64) * (np.pi / 4.0)
    yield from np.concatenate([quarters, np.nextafter(quarters, 9.0)]).astype(np.float32).view(np.uint32).tolist()
    uniform = rng.uniform(-ANGLE_MAX_rad, ANGLE_MAX_rad, count // 2)
    small = np.sign(uniform) * 10.0 ** rng.uniform(-44.0, 2.0, count // 2)
    yield from np.concatenate([uniform, small]).astype(np.float32).view(np.uint32).tolist()


def _refuse(where: str, fields: list[str]) -> None:
    if fields:
        more = f" and {len(fields) - PATIENCE} more" if len(fields) > PATIENCE else ""
        raise DifferenceError(f"{where}: target and host differ in {', '.join(fields[:PATIENCE])}{more}")


def _shown(frames: list[FrameIn]) -> str:
    return " ".join(f"{identifier:03X}#{data.hex().upper()}" for identifier, data in frames) or "nothing"
