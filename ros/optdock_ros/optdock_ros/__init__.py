"""ROS 2 nodes that take the place of Nav2's smoother, planner and docking servers."""
