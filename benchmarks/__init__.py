"""Hold the benchmarks for developers; run one by ``python -m benchmarks.NAME`` in the top folder of a checkout."""
