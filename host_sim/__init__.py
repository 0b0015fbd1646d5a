"""Simulator of the slipping robot, and the other end of the firmware's CAN bus."""
