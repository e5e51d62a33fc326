"""Use a planner as a library."""
