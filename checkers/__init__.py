"""Goal checkers: plugins of `optdock.goal_checkers`."""
