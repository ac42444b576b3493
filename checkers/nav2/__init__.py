"""Nav2's goal checkers, with its parameters, defaults and comparisons: position, simple, stopped, adaptive."""
