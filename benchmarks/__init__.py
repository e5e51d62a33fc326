"""Hold benchmarks for developers; run ``python -m benchmarks.NAME --help`` at the top of a checkout."""
