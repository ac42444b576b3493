"""Experiments, benchmarks and the fuzzer. They import the library; the library does not import them."""
