"""Generators of random cases; each is a deterministic function of a random generator."""
