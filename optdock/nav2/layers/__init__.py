"""Costmap layers: plugins that write costs into the master grid of a `LayeredCostmap`, in order."""
