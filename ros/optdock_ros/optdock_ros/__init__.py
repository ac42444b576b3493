"""ROS 2 nodes that replace Nav2's smoother and docking servers."""

import os

# Set before NumPy is loaded, also for the planning process: on a busy machine the threads of its linear algebra wait
# for each other, and calls take up to eight times as long.
os.environ.setdefault("OMP_NUM_THREADS", "1")
