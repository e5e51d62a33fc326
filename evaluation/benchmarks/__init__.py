"""Benchmarks behind `asg bench`, one file per part, and the scene of a whole floor (`floor`)."""
