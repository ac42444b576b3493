"""Collision: clearance of the swept footprint, from the scene to linear rows.

scene          obstacles, body and required clearance as arrays
broad_phase    which pairs of interval and obstacle may be near, by boxes
narrow_phase   separating planes and proven margins of these pairs
active_pairs   which of them get rows in the next step
linearization  rows of separating planes and of covering discs
"""
