"""How much goes over the bus: frames and bits over the last second, of whatever node."""

import math
from collections import deque

from host_sim.busload import worst_case_bits

BUCKET_S = 0.1
BUCKETS = 10  # a second is looked at


class Traffic:
    """Frames and their bits in buckets of time, worst-case stuffing counted."""

    def __init__(self) -> None:
        self.frames = 0
        self._buckets: deque[list[int]] = deque(maxlen=BUCKETS + 1)  # number, frames, bits
        self._first_s = math.nan

    def add(self, time_s: float, length_bytes: int) -> None:
        """Count a frame of so many data bytes; a clock that goes back is taken to stand."""
        if not self.frames:
            self._first_s = time_s
        self.frames += 1
        number = int(time_s // BUCKET_S)
        if not self._buckets or number > self._buckets[-1][0]:
            self._buckets.append([number, 0, 0])
        bucket = self._buckets[-1]
        bucket[1] += 1
        bucket[2] += worst_case_bits(length_bytes)

    def per_second(self, now_s: float) -> tuple[float, float]:
        """Return frames and bits a second over the whole buckets of the second before an instant."""
        now = int(now_s // BUCKET_S)
        seen = [bucket for bucket in self._buckets if now - BUCKETS <= bucket[0] < now]
        span_s = now * BUCKET_S - max(self._first_s, (now - BUCKETS) * BUCKET_S)
        if not seen or span_s < BUCKET_S / 2:
            return 0.0, 0.0
        return sum(bucket[1] for bucket in seen) / span_s, sum(bucket[2] for bucket in seen) / span_s
