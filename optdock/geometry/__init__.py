"""Poses, curves, convex polygons and their distances: the lowest layer, knows nothing of robots."""
