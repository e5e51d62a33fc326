"""Benchmarks behind `asg bench`, one file per part."""
