"""The independent oracle: its own curves, its own clearances by shapely, its own rules.

Nothing here imports optdock. It reads cases (plain data), samples densely, refines where it is tight, and claims a
fault only where a pose or an instant shows it.
"""
