"""Time parameterization: how fast a robot drives along a path, in closed phases of constant jerk.

The problem, for every segment of a path between two stops (its start, cusps, the dock): with arc length s, speed
v = ds/dt >= 0, its rate a, jerk j, curvature k(s) and its rate k'(s),

    minimize   the time T
    subject to v <= v_cap(s)                the speed caps: speed, yaw rate, lateral acceleration, wheels, approach zone
               -D <= a <= A,  |j| <= J      the drive
               |a k + v^2 k'| <= al         the yaw acceleration
               (s, v, a) given at the start, at rest at the end.

In x = v^2 all but jerk is linear and the time is convex. So a reference is solved for as a convex program in x with an
extension for jerk; ruckig turns it into exact motions; a proof that knows none of this decides. The chapters in reading
order:

    settings            every tuned constant, with its reason
    motion              states, and motions as phases of constant jerk
    path_limits         speed caps and maximum velocity curve along a segment, and how much of them a motion uses
    checks              the plan that is made of a motion over a segment, judged by the dense check
    start_states        full braking: what can be driven from a moving start, and what to say where nothing can
    strategy            from the path to the proven time law: all starts, all retries, the deadline, the proof
    forward_backward    the forward-backward pass: the fastest speeds without jerk
    reference_program   the convex program in v^2 with its jerk extension: arcs, knots, rows, initial guess, solution
    interior_point      its solver, on plain arrays
    ruckig_moves        exact motions from state to state, and along the reference
    windowed            the plugin `Windowed`: constant limits in windows, simple and sure
    near_optimal        the plugin `NearOptimal`: reference and moves, repair by stretching and tightening, then windows
"""
