"""python-can's SocketCAN bus with fewer system calls a frame."""

import socket

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.socketcan.socketcan import build_can_frame


class PromptSocketcanBus(SocketcanBus):
    """Sends at once, waits only where there is no room, and knows of other hosts on this machine.

    python-can reads the clock and waits for room before each frame: a system call each under User-Mode Linux, and with
    them sending took three times as long.
    """

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; where there is no room, wait for it so long."""
        try:
            self.socket.send(build_can_frame(msg))
        except OSError:
            super().send(msg, timeout)  # waits, or says what is wrong

    _claimed: socket.socket | None = None

    def claim(self, node: int) -> bool:
        """Have the robot of a node for ourselves while this bus is open; False: another process here has it.

        An abstract Unix socket is the mark: as a CAN interface it belongs to one network namespace, and the kernel
        takes it away with the process, however that ends.
        """
        if self._claimed is None:
            claimed = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                claimed.bind(f"\0omnibot {self.channel} {node}")
            except OSError:
                claimed.close()
                return False
            self._claimed = claimed
        return True

    def shutdown(self) -> None:
        """Close the bus, and let others have the robot."""
        super().shutdown()
        if self._claimed is not None:
            self._claimed.close()
            self._claimed = None
