"""Calibration study: compares the estimates of `optdock.calibration` with the hidden truth of simulated robots."""
