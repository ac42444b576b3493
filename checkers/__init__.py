"""Goal checkers: at the end of the path (`axis`), in the dock (`dock_goal`), and those of Nav2 (`nav2`)."""
