"""Controllers: velocity commands that follow a path or trajectory."""
