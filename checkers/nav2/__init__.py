"""Nav2's goal checkers, with Nav2's parameters, defaults and comparisons."""
