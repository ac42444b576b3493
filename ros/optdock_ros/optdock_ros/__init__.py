"""ROS 2 nodes that take the place of Nav2's smoother, planner and docking servers."""

import os

# Before NumPy is loaded: on a busy machine the threads of its linear algebra wait for each other, and calls take up to
# eight times as long. The planning process inherits it; a value that is set already is kept.
os.environ.setdefault("OMP_NUM_THREADS", "1")
