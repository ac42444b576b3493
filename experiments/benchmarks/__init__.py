"""Benchmarks: `python -m experiments.benchmarks [NAME ...]` measures and prints tables; see `__main__`."""
