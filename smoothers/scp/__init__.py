"""Algorithm of `CasadiSmoother`: sequential convex programming on clothoid splines (piecewise-linear curvature).

    minimize    length + curvature^2 + curvature rate^2 + distance to the input^2
    over        curvatures K at the knots, lengths L of the gears
    subject to  curvature and curvature rate within their limits,
                the end of the path on the goal (moved back by the final straight),
                clearance of the swept footprint from every obstacle,
                the marker of the dock in the camera's view where required.

Modules in reading order: settings, basis, rollout, nlp, cost, goal_projection, initial_guess, collision,
visibility_constraint, qp_step, loop, search, pieces_between_turns, refusals. Results are certified by
`optdock.verification`, whose code is independent of this package.
"""
