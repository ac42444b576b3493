"""Manoeuvre benchmark: plans or impossibility proofs for hard docking problems; `python -m experiments.manoeuvres`."""
