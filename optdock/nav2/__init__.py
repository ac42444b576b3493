"""Nav2: its parameter files, dock databases, costmap layers and behaviors.

Planning and proofs do not import this package.

Nav2's smoothers are in `smoothers.nav2`, its goal checkers in `checkers.nav2`.
"""
