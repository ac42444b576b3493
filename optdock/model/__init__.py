"""What is planned with: paths and their segments, motions, limits, robots, docks, problems, measurements."""
