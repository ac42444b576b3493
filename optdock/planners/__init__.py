"""Global planners: `DockPlanner`, a NURBS path of two segments from anywhere in front of a dock into it.

`dock_planner` is the plugin, `dock_parameters` what it can be told. The method is in two chapters: `approach_axis`
(steps 1 to 4: the axis through the dock, the gear, how sharply the robot may turn onto it) and `two_segment` (steps 5
to 8: sampled curves, the joint with the axis, the assembled path).
"""
