"""Plots by matplotlib (extra ``plot``): shapes in space, quantities along the arclength, and over time.

``plots`` is where to begin. ``scene`` draws a robot in space, ``along`` curves along the arclength, ``over_time`` curves of a
history; ``family`` chooses instances of a batch and their colours; ``canvas`` makes axes, and says what to install where
matplotlib is missing.
"""

from multirod.plotting.plots import plot_history, plot_solution

__all__ = ["plot_history", "plot_solution"]
