"""Random cases, each a function of a random generator and of nothing else."""
