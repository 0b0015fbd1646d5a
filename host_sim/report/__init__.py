"""The pages that omnibot writes: each one file that needs nothing else, drawn and styled alike."""

from host_sim.report.page import PAGE_NAME
from host_sim.report.run import write_report

__all__ = ["PAGE_NAME", "write_report"]
