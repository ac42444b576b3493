"""Nav2: its parameter files, dock databases, costmap layers and behaviors; planning and proofs do not import them.

Nav2's smoothers are in `smoothers.nav2`, its goal checkers in `checkers.nav2`.
"""
