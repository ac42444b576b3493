"""`ManoeuvrePlanner`: from anywhere into the dock with as many cusps as it takes.

`manoeuvre_planner` is the plugin, `stages` the order in which it looks. Both ends grow trees of arcs (`tree`), and
Reeds-Shepp words (`reeds_shepp`) join their nodes (`connections`), farther afield in hybrid A* (`hybrid_a_star`,
`wavefront`); `free_space` says which poses are free, `price` what
a manoeuvre costs.
"""
