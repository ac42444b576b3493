"""Docking study: final accuracy, contact and success rate of several docking methods in realistic simulated worlds."""
