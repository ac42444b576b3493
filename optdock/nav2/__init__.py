"""What speaks Nav2: its files, its costmap and its behaviors; the method knows nothing of it.

- `params`: a parameter file: its plugins, costmaps, dock types and docks (`plugin_lists`, `costmap_params`, `numbers`).
- `docks`: dock databases and dock types.
- `scenario`: the docking problem that these files describe.
- `provided_plugins`: which of a file's plugins are provided here, with which parameters, and why the others are not.
- `global_costmap`: the costmap that a parameter file describes, over a map.
- `layered_costmap`, `layers`: one master grid, and the layers that write into it.
- `behaviors`: BackUp, DriveOnHeading.

Nav2's smoothers are in `smoothers.nav2`, its goal checkers in `checkers.nav2`.
"""
