"""Measurements for developers: ``python -m benchmarks.NAME --help``, at the top of a checkout."""
