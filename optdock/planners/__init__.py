"""Global planners: `DockPlanner`, a NURBS path of two segments, and `ManoeuvrePlanner`, a search with cusps."""
