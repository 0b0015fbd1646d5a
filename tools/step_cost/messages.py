"""What encoding and decoding each message costs: values of every size and none, frames good, damaged and cut short."""

import struct

import numpy as np

from step_cost.corpus import NODE, SEED
from step_cost.layout import Layout, layouts
from step_cost.machine import FRAME, FRAME_BYTES, SCRATCH
from step_cost.measure import Figures, Target
from step_cost.paths import Cost

VALUES = 60  # structs a message
LENGTH_BYTE, FIRST_DATA_BYTE = 2, 3


def _random_struct(layout: Layout, rng: np.random.Generator) -> bytes:
    """Fill a message's struct; its floats are its four-byte fields or look like them, and any bits will do."""
    made = bytearray(rng.bytes(layout.size))
    for leaf in layout.leaves:
        if leaf.size == 4 and rng.random() < 0.9:
            value = rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-5.0, 3.0)
            struct.pack_into("<f", made, leaf.offset, float("nan") if rng.random() < 0.1 else value)
    return bytes(made)


class Messages:
    """Encoder and decoder of each message of the wire on the emulated processor."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._layouts = layouts(target.image.file)
        suffix = "_message_t"
        self._names = [name.removesuffix(suffix) for name in self._layouts if name.endswith(suffix)]

    def measure(self) -> dict[str, dict[str, Figures]]:
        """Return the figures of 'encode' and 'decode' by message."""
        rng = np.random.default_rng(SEED)
        return {name: self._measure(name, self._layouts[f"{name}_message_t"], rng) for name in self._names}

    def _measure(self, name: str, layout: Layout, rng: np.random.Generator) -> dict[str, Figures]:
        encode, decode = (self._target.image.function(f"{name}_{verb}") for verb in ("encode", "decode"))
        figures = {"encode": Figures(), "decode": Figures()}
        machine = self._target.machine
        for _ in range(VALUES):
            machine.write(SCRATCH, _random_struct(layout, rng))
            figures["encode"].add(self._cost(encode, FRAME, NODE, SCRATCH))
            frame = machine.read(FRAME, FRAME_BYTES)
            damaged = bytearray(frame)
            damaged[FIRST_DATA_BYTE] ^= 1 << int(rng.integers(8))
            cut = bytearray(frame)
            cut[LENGTH_BYTE] -= 1
            for received in (frame, damaged, cut):
                machine.write(FRAME, bytes(received))
                figures["decode"].add(self._cost(decode, SCRATCH, FRAME))
        return figures

    def _cost(self, function: int, *arguments: int) -> Cost:
        machine = self._target.machine
        del machine.path[:]
        machine.begin_call()
        machine.call(function, *arguments)
        return self._target.blocks.cost(self._target.path()).total
