"""Time parameterization: the fastest motion along a path within all limits, in exact phases of constant jerk.

The following problem is solved for every segment of a path between two stops (start, cusps, dock). With arc length s,
speed v = ds/dt >= 0, its rate a, jerk j, curvature k(s) and its rate k'(s):

    minimize   the duration T
    subject to v <= v_cap(s)                the speed caps: speed, yaw rate, lateral acceleration, wheels, speed zone
               -D <= a <= A,  |j| <= J      the limits of the drive
               |a k + v^2 k'| <= al         the limit of the yaw acceleration
               (s, v, a) given at the start, at rest at the end.

In x = v^2 all limits except jerk are linear and the duration is convex. A reference is the solution of a convex program
in x with an extension for jerk. ruckig turns it into exact motions, which an independent proof accepts or rejects.
Modules in reading order: jerk_phases, turning_limits, path_limits, plan_checks, start_states, retry_strategy, windowed
(plugin `Windowed`), forward_backward, reference_grid, reference_program, interior_point, ruckig_moves, near_optimal
(plugin `NearOptimal`).
"""
