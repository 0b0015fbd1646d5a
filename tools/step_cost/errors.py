"""What the user can cure."""

from host_sim.errors import OmnibotError


class CostError(OmnibotError):
    """The cost cannot be told; the message says why and what to do."""
