"""Poses, curves, convex polygons and their distances; the lowest layer, independent of robots."""
