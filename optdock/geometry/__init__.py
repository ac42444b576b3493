"""Poses, curves, convex polygons and distances between polygons: the lowest layer, independent of robot models."""
