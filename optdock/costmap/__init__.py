"""Grids of costs: layers, inflation, distance fields, and cells as obstacles."""
