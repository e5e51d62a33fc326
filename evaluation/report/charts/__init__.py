"""Draw charts as SVG: convergence curves, intervals, and the history of an episode."""
