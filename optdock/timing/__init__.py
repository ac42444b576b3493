"""Time parameterizers: the time law of a path, by ruckig."""
