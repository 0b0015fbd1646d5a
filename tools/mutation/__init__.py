"""Mutation testing of the firmware's C; see tools/mutate."""
