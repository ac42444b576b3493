"""Layered costmap and its layers: plugins that write costs into one master grid, in order."""
