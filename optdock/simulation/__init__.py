"""A closed loop in simulation: plant, noise, latency, run."""
