"""Nav2's goal checkers, with its parameters, defaults and comparisons."""
