"""Costmap layers: plugins that write costs into a grid, in order."""
