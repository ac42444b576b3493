"""Goal checkers (`optdock.goal_checkers`): by the end of the path (`axis`), in the dock (`dock`), Nav2's (`nav2`)."""
