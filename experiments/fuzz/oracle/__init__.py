"""Independent oracle: separate curves, separate clearances by shapely, separate rules.

Does not import optdock. It reads cases (plain data), samples densely, refines where margins are small, and reports a
fault only with a violating pose or instant.
"""
