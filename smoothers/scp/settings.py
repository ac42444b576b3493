"""Every tuned constant of the method, chapter by chapter, with its reason.

Unless a line says otherwise a value was chosen by `python -m experiments.benchmarks smoothing --seeds 30` (rate of
certified results, milliseconds to the end and to the first certified path, cost), and the costs against the optimum by
`python -m experiments.benchmarks optimality`. What a user chooses stands in `CasadiSmootherParameters` instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = [
    "DEFAULT_SETTINGS",
    "AnytimeSettings",
    "BoundSettings",
    "CollisionSettings",
    "GoalProjectionSettings",
    "GuessSettings",
    "LoopSettings",
    "ResolutionSettings",
    "Settings",
    "StepSettings",
    "TrackingSettings",
    "ViewSettings",
]


@dataclass(frozen=True)
class ResolutionSettings:
    """How finely the path is described: spans of linear curvature, and the collision intervals within them."""

    longest_span: float = 1.2  # of the smallest turning radius: longer spans cost up to 1 % on long paths
    most_spans: int = 80  # the programs grow with the square of it
    fewest_spans: int = 4  # per gear: pose, curvature and rate at both ends want so many
    fewest_intervals: int = 2  # per span
    most_intervals: int = 12  # per span
    body_radius: float = 0.55  # [m]: the interval parameter is meant for such a body; larger ones take longer intervals
    many_obstacles: int = 60  # every node meets every obstacle: from here on nodes are fewer ...
    coarser_among_many: float = 1.3  # ... by this: a sixth less time for 0.3 % of the cost
    input_samples: int = 40  # per gear of the input, to find the obstacles around it
    fit_smoothing: float = 1e-4  # of the least-squares fit of curvatures to headings: kinks do not ring


@dataclass(frozen=True)
class BoundSettings:
    """Bounds of the variables, and the reference values of the cost where a limit is infinite."""

    curvature_cap: float = 20.0  # [1/m] stands for an unlimited one: a radius of 5 cm, below any wheeled robot's
    curvature_inside: float = 0.999  # of the limit is what steps aim at; goal projection may use the rest
    rate_inside: float = 0.99  # likewise
    shortest_gear: float = 0.02  # [m]: a gear never vanishes
    longest_gear: tuple[float, float] = (4.0, 20.0)  # times the input's, and [m] on top: never met, only finite
    unlimited_curvature: float = 1.5  # [1/m]: reference where curvature is unlimited
    unlimited_rate: float = 4.0  # [1/m]: reference rate per reference curvature where the rate is unlimited


@dataclass(frozen=True)
class GoalProjectionSettings:
    """Newton steps of least norm onto the goal."""

    tolerance: float = 1e-7  # [m, rad]
    max_steps: int = 5
    contraction: float = 0.7  # of the error: a step that leaves more is not taken
    renew: float = 1e-3  # error from which on the old derivatives do for the remaining steps
    reach: float = 0.5  # of the smallest radius: error from which on Newton steps lead astray
    alternations: int = 2  # between the goal and the curvature rate
    polished: float = 1e-11  # of the roll-out, which is within some 1e-9 of the spline
    exact: float = 3e-8  # [m, rad] of the spline itself, a thirtieth of what the certificate accepts
    exact_steps: int = 4


@dataclass(frozen=True)
class GuessSettings:
    """The first variables, and how boldly the search begins at them."""

    astray: float = 0.4  # [m]: a fit that leads further from the input is not begun with
    turned_away: float = 0.4  # [rad], likewise at the goal
    off_the_input: float = 0.15  # [m]: a fit that leads further from the input may be worse than a tracked one
    trackable: float = 0.4  # [m]: an input that cannot be tracked more closely is not drivable
    much_nearer: float = 0.1  # likewise, of how far the others lead away
    different: float = 0.15  # [m]: guesses closer together lead to the same result
    different_on_the_input: float = 0.03  # [m], likewise, where the one is on the input
    pursuit_step: float = 0.25  # of the smallest radius, at most
    pursuit_longest: float = 3.0  # times the input, and a loop
    earlier_spacing: float = 0.02  # [m], of the search for the robot on the earlier path
    earlier_lost: float = 0.5  # [m]: a robot further from the earlier path does not follow it
    earlier_shortest: float = 0.02  # [m]: less left of a gear is not a guess
    trust_region: float = 0.45  # [rad]: first bound of the heading changes; 0.2 to 1.0 make no difference
    bold_length: float = 12.0  # times the smallest radius: longer paths begin with smaller steps
    proximal: float = 0.67  # [m]: first weight of squared motion, times the largest curvature; 0.1 to 5 likewise
    trust_region_near: float = 0.2  # an earlier result is near the new one
    proximal_near: float = 0.067
    patience: int = 4  # iterations within which a shortfall must shrink
    spans_per_patience: int = 32  # paths with more spans get as much more patience
    patience_other: int = 3  # with the other guess: most problems that got so far have no answer


@dataclass(frozen=True)
class TrackingSettings:
    """Least squares of positions, for a first guess that stays on the input."""

    weight: float = 30.0  # [1/m^3] of squared distance across the input: a hundred times the search's
    along: float = 0.1  # times as much along it: rounding an input whose curvature jumps makes it a little shorter
    cusp: float = 1.0  # times as much at cusps, in both directions: there the input's positions are anchors
    smoothness: float = 0.05  # times the search's weight of the squared curvature rate
    goal_weight: float = 100.0  # [1/m] of the error at the goal
    proximal: float = 1e-3  # weight of the squared step
    trust_growth: float = 2.0
    most_trust: float = 0.9  # [rad]
    trust_cut: float = 0.3
    most_steps: int = 20  # where a first turn was missed on a long path; five otherwise
    most_intervals: int = 3  # per span: positions tell no more, and obstacles do not count here
    small_gain: float = 0.05  # of the merit, not worth a further step
    near: float = 0.02  # [m] from the input everywhere is near enough


@dataclass(frozen=True)
class CollisionSettings:
    """Which pairs of interval and obstacle are looked at, and how they become rows."""

    crop: float = 1.0  # [m] beyond the input path: obstacles further away are not looked at
    # Broad phase
    few_pairs: int = 150  # below, none is dropped
    nearest: int = 3  # obstacles of every interval, where there are more pairs
    nearest_close: int = 4  # times as many where they might be too close: the boxes are coarse
    surely_kept: float = 0.01  # [m] beyond the required clearance: such pairs might be too close
    grouped_intervals: int = 6  # neighbours whose common box is looked at first: cheapest among 100 to 1000 obstacles
    # Narrow phase
    facing_edges: int = 12  # of a body with more, those most along the best other axis: 8 miss millimetres
    lowest_vertices: int = 8  # that can carry the lower side of a hull; more make quadratically many chords
    lowest_slope: float = 0.35  # how they are chosen among more
    # Active pairs
    few_planes: int = 80  # where there are more pairs, not all of them get planes
    thins_small_obstacles: bool = True  # among many pairs small obstacles get planes where they are closest only
    clear: float = 1e-3  # [m]: a path with a smaller shortfall counts as clear
    deep: float = 0.06  # of the body's width: overlap from which planes no longer tell the side
    very_deep: float = 0.18  # [m]: with such a pair at hand ...
    near_deep: float = 0.15  # ... all pairs with less margin than this count as deep
    # Linearization
    support_slope: float = 0.35  # sides flatter than this share their support: rows at both ends of it
    same_witness: float = 0.005  # [m]: witness points closer together say the same
    discs_per_node: int = 2  # the deepest ones, per obstacle
    most_discs: int = 32  # of a part; those of a thinner one leave gaps, which the planes see once it is out


@dataclass(frozen=True)
class StepSettings:
    """The quadratic program of one step."""

    zones: int = 6  # of the path, with one slack of clearance each: one alone costs 1 %, twelve cost time
    trust_nodes: int = 12  # whose headings the trust region bounds, at least
    clearance_rows: tuple[int, ...] = (48, 96, 160, 256, 400)  # programs are built for so many, and used again
    usual_shapes: tuple[tuple[tuple[int, int], ...], ...] = (  # built at warm-up: one to three gears
        ((24, 2),),
        ((24, 3),),
        ((24, 4),),
        ((12, 3), (12, 3)),
        ((8, 3), (8, 3), (8, 3)),
    )
    usual_clearance_rows: int = 3  # the first of `clearance_rows`, likewise
    buffer: float = 8e-4  # [m]: clearance aimed at above the requirement; 0 takes a fifth more iterations
    buffer_taper: float = 0.1  # [m]: less near the ends, where the pose cannot move
    yaw_motion: float = 0.3  # [m^2]: what a radian counts in the squared motion
    curved_goal_slack: float = 100.0  # curvature of the slacks: DAQP wants a positive definite Hessian
    curved_clearance_slack: float = 10.0
    ridge: float = 1e-6


@dataclass(frozen=True)
class LoopSettings:
    """Acceptance, trust region, penalties and ends of the sequential programs."""

    reach: float = 0.15  # [m] beyond the required clearance: pairs looked at in the first iteration
    most_reach: float = 0.35  # [m], after a long step
    least_reach: float = 0.08  # [m], near the end
    reach_per_motion: float = 1.5
    goal_tolerance: float = 1e-5  # [m, rad]: an iterate so close is projected exactly in the end
    clearance_tolerance: float = 1e-6  # [m], as the certificate's
    end_allowance: float = 5e-4  # [m]: the end poses are given, and the bound between nodes is cautious
    clearance_penalty: float = 300.0  # [1/m]; 100 to 1000 make no difference
    goal_penalty: float = 1000.0  # [1/m]
    raised: float = 6.0  # times the clearance penalty, where a shortfall costs less than the path
    goal_above_clearance: float = 3.0  # times the clearance penalty, at least
    most_penalty: float = 300.0 * 36.0
    raised_trust: float = 0.1  # [rad] at least, after the penalty was raised
    raised_proximal: float = 1.0  # at most
    trust_growth: float = 2.0
    most_trust: float = 0.9  # [rad]
    trust_cut: float = 0.3
    proximal_growth: float = 3.0
    proximal_cut: float = 0.3
    least_proximal: float = 1e-3
    overshot: float = 5e-3  # [m]: a smaller shortfall is added to the buffer: 6 iterations become 2 or 3 round a corner
    small_step: float = 3e-4  # [rad]: a feasible iterate with a smaller trust region has converged
    small_gain: float = 1e-3  # of the cost, not worth a step: at most 0.35 % above the optimum of ipopt
    max_rejections: int = 7
    shrinking: float = 0.93  # of its shortfall keeps an infeasible iterate whose patience is at its end


@dataclass(frozen=True)
class ViewSettings:
    """Where the dock must be seen: rows of the view, and penalties for which the goal is worth more than the view.

    With the usual penalties a search in vain gives up the goal rather than the view: of 60 starts within 3.5 m of a
    dock, cone of 60 degrees, 16 instead of 8 were said to miss the goal. 38 were certified with either.
    """

    reach: float = 0.35  # [m]: margins beyond it get no row; as `LoopSettings.most_reach`
    goal_penalty: float = 3000.0  # [1/m]; 6000 makes no difference
    goal_above_clearance: float = 10.0  # times the clearance penalty, at least: more than all zones together


@dataclass(frozen=True)
class AnytimeSettings:
    """Repairs, given candidates, and what things are expected to take until they were measured.

    The seconds were measured on the machine of the benchmarks; `CasadiSmoother.warm_up` measures how much slower or
    faster this one is. Each triple: without obstacles; per obstacle nearby; per metre, obstacle and part of the body.
    """

    certificate_seconds: tuple[float, float, float] = (0.0025, 1.2e-5, 8e-7)
    iteration_seconds: tuple[float, float, float] = (0.0013, 2e-5, 0.0)
    iteration_per_corner: float = 4e-5  # [s] for every corner of the footprint, in nine of ten iterations at most
    certificate_per_iteration: float = 1.2  # until a certificate was measured, how fast this machine is was
    longest_fades: float = 0.8  # of the longest iteration so far is expected again
    iteration_reserve: float = 1.1
    certificate_reserve: float = 1.2
    grace: float = 0.0015  # [s]: how late the only certificate may be expected to end
    latest: float = 0.0005  # [s] past the end of the budget: what a certificate has not proven by then it leaves
    pace_range: tuple[float, float] = (0.5, 4.0)  # of the measured speed of this machine: beyond is a disturbance
    pace_at_warm_up: float = 0.6  # shortest over expected iteration of the warm-up on the machine of the benchmarks
    repairs: int = 2  # of a path that the certificate refused
    repair_nearest: int = 4  # times the obstacles looked at in every interval, at each repair
    repair_buffer: float = 3.0  # times the buffer, at each repair
    repair_finer: int = 2  # times the intervals, at a repair of what only the bound between nodes is against
    nearly: float = (
        5e-3  # [m]: a shortfall that may be due to the cautious bound between nodes: the certificate decides
    )
    nearly_in_sags: float = 2.0  # likewise, in what that bound can lose: 5 cm for a car, 3 mm for a robot of 0.9 m
    same_pose: float = 1e-6  # [m, rad], as the certificate's
    on_axis: float = 1e-7  # [m, rad]: a robot there drives the straight line
    staging: float = 0.05  # [m] before the final straight: from further away there is something to optimize


@dataclass(frozen=True)
class Settings:
    """All of them."""

    resolution: ResolutionSettings = field(default_factory=ResolutionSettings)
    bounds: BoundSettings = field(default_factory=BoundSettings)
    projection: GoalProjectionSettings = field(default_factory=GoalProjectionSettings)
    guess: GuessSettings = field(default_factory=GuessSettings)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    collision: CollisionSettings = field(default_factory=CollisionSettings)
    step: StepSettings = field(default_factory=StepSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    view: ViewSettings = field(default_factory=ViewSettings)
    anytime: AnytimeSettings = field(default_factory=AnytimeSettings)


DEFAULT_SETTINGS = Settings()
