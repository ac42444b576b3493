"""What tests and benchmarks share: docking problems drawn from families, and an independent dense checker."""
