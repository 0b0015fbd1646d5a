"""Every figure and table of the paper beside ours: the verb ``omnibot paper``."""

from host_sim.paper.write import ITEMS, choose, write_paper

__all__ = ["ITEMS", "choose", "write_paper"]
