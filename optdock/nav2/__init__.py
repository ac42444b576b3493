"""Nav2: parameter files, dock databases, costmap layers and behaviors, none of which planning and proofs import.

Nav2's smoothers are in `smoothers.nav2`, its goal checkers in `checkers.nav2`.
"""
