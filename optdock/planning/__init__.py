"""From a problem to a certified plan: the portfolio of guesses, their refinement, plans, replanning."""
