"""Planning and replanning: from a docking problem to a certified plan."""
