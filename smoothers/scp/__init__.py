"""The method of `CasadiSmoother`: sequential convex programming on splines of linear curvature.

    minimize    length + curvature^2 + curvature rate^2 + distance to the input^2
    over        curvatures K at the knots, lengths L of the gears
    subject to  curvature and curvature rate within their limits,
                the end of the path on the goal (moved back by the final straight),
                everything that the footprint sweeps as far from every obstacle as required,
                the marker of the dock in the camera's view where it must be seen.

The chapters, in reading order:

    settings         every tuned constant, with its reason
    basis            splines of piecewise linear curvature, as constant matrices
    rollout          driving a spline exactly, and the derivatives of its poses
    problem          from a docking problem and an input path to the nonlinear program
    cost             what is minimized, its gradient and Hessian
    goal_projection  the smallest change that brings the end onto the goal; the exact path
    initial_guess    fit to the headings, pure pursuit, what is left of an earlier result
    collision        scene, broad phase, narrow phase (separating planes), active pairs, linearization
    visibility       the marker in view: margins at the nodes of the last stretch, linearization
    qp_step          the convex program of a step: named blocks, trust region, L1 penalties, DAQP
    loop             sequential convex programming: linearize, step, project, accept by merit
    strategy         all that is tried, in one list, within the time that is given; certificates
    refusals         which bound is in the way where nothing is found

The verdict about a result is `optdock.verification`'s, by another method; what is proven here guides the search.
"""
