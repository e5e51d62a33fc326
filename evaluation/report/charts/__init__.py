"""Charts as SVG: convergence curves, intervals, the timeline of an episode."""
