"""Global planners: the raw path."""
