"""Goal checkers (`optdock.goal_checkers`): along the end of the path (`axis`), in the dock, and Nav2's (`nav2`)."""
