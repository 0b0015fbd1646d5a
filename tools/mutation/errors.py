"""What a user may have done wrong."""


class MutationError(Exception):
    """Carries the whole message."""
