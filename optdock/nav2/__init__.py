"""Nav2: its files, its costmap layers and its behaviors; the method does not depend on this package.

- `params`: parameter files: plugins (`plugin_lists`), costmaps, dock types and docks.
- `docks`: dock databases and dock types.
- `docking_problem`: the docking problem that these files describe.
- `provided_plugins`: the plugins of a file that optdock provides, and the reasons for the others.
- `global_costmap`: the costmap of a parameter file, built over a map.
- `layered_costmap`, `layers`: a grid and the layers that write into it.
- `behaviors`: BackUp, DriveOnHeading.

Nav2's smoothers are in `smoothers.nav2`, its goal checkers in `checkers.nav2`.
"""
