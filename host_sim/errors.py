"""Errors a user can cure; the command line prints them in one line."""


class OmnibotError(Exception):
    """Something the user can put right; the message says what was wrong and what would be right."""
