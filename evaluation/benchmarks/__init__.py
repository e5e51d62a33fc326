"""Measure speeds for `asg bench`, one module per part."""
