"""The planning model: paths, motions, limits, robots, docks, problems and measurements."""
