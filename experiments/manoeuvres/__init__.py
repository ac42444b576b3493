"""Manoeuvres: from anywhere into the dock, or the proof that there is no way. `python -m experiments.manoeuvres`."""
