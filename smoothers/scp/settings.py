"""Tuned constants of the method, with the reasons for their values.

Unless noted, values were chosen with `python -m experiments.benchmarks smoothing --seeds 30`, by the share of certified
results, the time until the end and until the first certified path, and the cost. The costs were compared with the
optimum by `python -m experiments.benchmarks optimality`. User parameters are in `CasadiSmootherParameters`.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass, replace

from optdock.geometry.lazy import cached_property

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
    """Numbers of spans, in which the curvature is linear, and of collision intervals per span."""

    longest_span: float = 1.2  # of the smallest turning radius: longer spans cost up to 1 % on long paths
    most_spans: int = 80  # the programs grow with the square of it
    fewest_spans: int = 4  # per gear, for pose, curvature and rate at both ends
    fewest_intervals: int = 3  # per span: with 2, plans in parking slots cost 0.4 % more
    most_intervals: int = 12  # per span
    body_radius: float = 0.55  # [m]: the interval parameter is for such a body; larger ones have longer intervals
    many_obstacles: int = 60  # with more obstacles, intervals are longer ...
    coarser_among_many: float = 1.3  # ... by this factor: a sixth less time for 0.3 % of the cost
    input_samples: int = 40  # per gear of the input, to find the obstacles around it
    fit_smoothing: float = 1e-4  # of the least-squares fit of curvatures to headings: no oscillation at kinks


@dataclass(frozen=True)
class BoundSettings:
    """Bounds of the variables, and reference values of the cost for infinite limits."""

    curvature_cap: float = 20.0  # [1/m], instead of an unlimited one: a radius of 5 cm, below that of any wheeled robot
    curvature_inside: float = 0.999  # of the limit in steps; the rest is for the goal projection
    rate_inside: float = 0.99  # of the curvature rate limit in steps
    shortest_gear: float = 0.02  # [m]
    longest_gear: tuple[float, float] = (
        4.0,
        20.0,
    )  # times the length of the input, plus [m]: a bound that is never active
    unlimited_curvature: float = 1.5  # [1/m]: reference where curvature is unlimited
    unlimited_rate: float = 4.0  # [1/m]: reference rate per reference curvature where the rate is unlimited


@dataclass(frozen=True)
class GoalProjectionSettings:
    """Projection onto the goal by Newton steps of least norm."""

    tolerance: float = 1e-7  # [m, rad]
    max_steps: int = 5
    contraction: float = 0.7  # of the error: a step that leaves more is rejected
    renew: float = 1e-3  # error below which the derivatives are not updated
    reach: float = 0.5  # of the smallest radius: larger errors prevent convergence
    alternations: int = 2  # between the goal and the curvature rate
    polished: float = 1e-11  # of the roll-out, which is within about 1e-9 of the spline
    exact: float = 3e-8  # [m, rad] of the spline, a thirtieth of the tolerance of the certificate
    exact_steps: int = 4

    @functools.cached_property
    def of_exact_path(self) -> GoalProjectionSettings:
        """The settings with the tolerance `polished`."""
        return dataclasses.replace(self, tolerance=self.polished)


@dataclass(frozen=True)
class GuessSettings:
    """Initial variables of a search, and initial bounds on its steps."""

    astray: float = 0.4  # [m]: a fit farther from the input is not used
    turned_away: float = 0.4  # [rad]: a fit with a larger heading error at the goal is not used
    off_the_input: float = 0.15  # [m]: a fit farther from the input is compared with a tracked one
    trackable: float = 0.4  # [m]: an input that is tracked with a larger error is not drivable
    much_nearer: float = 0.1  # of the error of the others: a smaller error is also accepted
    different: float = 0.15  # [m]: closer guesses lead to the same result
    different_on_the_input: float = 0.03  # [m], for the tracked guess
    pursuit_step: float = 0.25  # of the smallest radius, at most
    pursuit_longest: float = 3.0  # times the input, and a loop
    earlier_spacing: float = 0.02  # [m] between poses of the earlier path
    earlier_lost: float = 0.5  # [m]: largest distance of the robot from the earlier path
    earlier_shortest: float = 0.02  # [m]: shortest rest of a gear
    trust_region: float = 0.45  # [rad]: first bound of the heading changes; 0.2 to 1.0 make no difference
    bold_length: float = 12.0  # times the smallest radius: longer paths have smaller first steps
    proximal: float = (
        0.67  # [m]: first weight of squared motion, times the largest curvature; 0.1 to 5 make no difference
    )
    trust_region_near: float = 0.2  # for an earlier result
    proximal_near: float = 0.067
    patience: int = 4  # iterations within which a shortfall must shrink
    spans_per_patience: int = 32  # paths with more spans have proportionally more patience
    patience_other: int = 3  # for the other guess: most problems are infeasible then


@dataclass(frozen=True)
class TrackingSettings:
    """Least-squares fit to positions, for a first guess that stays on the input."""

    weight: float = 30.0  # [1/m^3] of squared distance across the input: a hundred times the search's
    along: float = 0.1  # times as much along it: smooth paths are a little shorter than the input
    cusp: float = 1.0  # times as much at cusps, in both directions
    smoothness: float = 0.05  # times the search's weight of the squared curvature rate
    goal_weight: float = 100.0  # [1/m] of the error at the goal
    proximal: float = 1e-3  # weight of the squared step
    trust_growth: float = 2.0
    most_trust: float = 0.9  # [rad]
    trust_cut: float = 0.3
    most_steps: int = 20  # on long paths; usually five
    most_intervals: int = 3  # per span, enough for positions
    # Predicted gain, of the merit, that ends the iteration. The error at the goal does not count: searches project it.
    small_gain: float = 0.05
    near: float = 0.02  # [m]: largest distance that ends the iteration


@dataclass(frozen=True)
class CollisionSettings:
    """Selection of the pairs of interval and obstacle, and of their constraint rows."""

    crop: float = 1.0  # [m] beyond the input path: obstacles farther away are left out
    # Broad phase
    few_pairs: int = 150  # fewer pairs are all kept
    nearest: int = 3  # obstacles of every interval, where there are more pairs
    nearest_close: int = 4  # times as many of those that may be too close
    surely_kept: float = 0.01  # [m] above the required clearance: such pairs may be too close
    grouped_intervals: int = 6  # intervals with a common box: fastest for 100 to 1000 obstacles
    # Narrow phase
    facing_edges: int = 12  # of a body with more, those nearest to the best other axis; 8 lose millimetres
    lowest_vertices: int = 8  # of a hull; the number of chords grows with the square
    lowest_slope: float = 0.35  # for the choice among more vertices
    # Active pairs
    few_planes: int = 80  # with more pairs, not all of them have planes
    thins_small_obstacles: bool = True  # small obstacles have planes only where they are closest
    clear: float = 1e-3  # [m]: a smaller shortfall counts as clear
    deep: float = 0.06  # of the width of the body: overlaps beyond it have discs
    very_deep: float = 0.18  # [m]: with such an overlap ...
    near_deep: float = 0.15  # ... smaller margins count as deep [of the width]
    # Linearization
    support_slope: float = 0.35  # flatter sides share their support, with rows at both ends
    same_witness: float = 0.005  # [m]: closer witness points have one row
    discs_per_node: int = 2  # the deepest ones, per obstacle
    most_discs: int = 32  # of a part; thinner parts have gaps between discs


@dataclass(frozen=True)
class StepSettings:
    """Settings of the quadratic program of one step."""

    zones: int = 6  # of the path, with one slack each: a single one costs 1 %, twelve take more time
    trust_nodes: int = 12  # least number of headings in the trust region
    clearance_rows: tuple[int, ...] = (48, 96, 160, 256, 400)  # sizes of programs
    usual_shapes: tuple[tuple[tuple[int, int], ...], ...] = (  # built at warm-up: one to three gears
        ((24, 2),),
        ((24, 3),),
        ((24, 4),),
        ((12, 3), (12, 3)),
        ((8, 3), (8, 3), (8, 3)),
    )
    usual_clearance_rows: int = 3  # how many sizes of `clearance_rows` are built at warm-up
    buffer: float = 8e-4  # [m]: clearance above the requirement; with 0, a fifth more iterations
    buffer_taper: float = 0.1  # [m] from the ends, where the pose cannot move
    yaw_motion: float = 0.3  # [m^2]: weight of a squared radian in the motion
    curved_goal_slack: float = 100.0  # Hessian of the slacks: DAQP needs a positive definite one
    curved_clearance_slack: float = 10.0
    ridge: float = 1e-6


@dataclass(frozen=True)
class LoopSettings:
    """Acceptance, trust region, penalties and termination of a search."""

    reach: float = 0.15  # [m] above the required clearance: pairs in the first iteration
    most_reach: float = 0.35  # [m], after a long step
    least_reach: float = 0.08  # [m], near the end
    reach_per_motion: float = 1.5
    goal_tolerance: float = 1e-5  # [m, rad]: the rest is projected exactly
    clearance_tolerance: float = 1e-6  # [m], as the certificate's
    end_allowance: float = 5e-4  # [m]: the end poses are given, and the bound between nodes is conservative
    clearance_penalty: float = 300.0  # [1/m]; 100 to 1000 make no difference
    goal_penalty: float = 1000.0  # [1/m]
    raised: float = 6.0  # times the clearance penalty, where the shortfall costs less than the path
    goal_above_clearance: float = 3.0  # times the clearance penalty, at least
    most_penalty: float = 300.0 * 36.0
    raised_trust: float = 0.1  # [rad] at least, after the penalty is raised
    raised_proximal: float = 1.0  # at most
    # in a step that was not rejected before; always, an eighth more steps in parking slots
    trust_growth: float = 2.0
    most_trust: float = 0.9  # [rad]
    trust_cut: float = 0.3
    proximal_growth: float = 3.0
    proximal_cut: float = 0.3
    least_proximal: float = 1e-3
    overshot: float = 5e-3  # [m]: a smaller shortfall is added to the buffer: 2 or 3 instead of 6 iterations at corners
    # Times the shortfall of a step that lowers the cost, added to the required clearance before another try: with 1 to
    # 2, 5 % fewer evaluations and linearizations, and 0.2 % lower prices of long paths, than without.
    corrected: float = 1.5
    small_step: float = 3e-4  # [rad]: a feasible iterate with a smaller trust region has converged
    small_gain: float = 1e-3  # of the cost: ends the search, at most 0.35 % above the optimum of ipopt
    max_rejections: int = 7
    # In a row, at an infeasible iterate: in 36 parking slots 1 of 40 accepted steps, but a sixth of the rejected ones,
    # follow more rejections, and all plans are the same.
    max_rejections_infeasible: int = 3
    shrinking: float = 0.93  # of the shortfall: continues an infeasible search beyond its patience


@dataclass(frozen=True)
class ViewSettings:
    """Rows of the required view, and penalties that let an infeasible search violate the view rather than the goal."""

    reach: float = 0.35  # [m]: larger margins have no row; as `LoopSettings.most_reach`
    goal_penalty: float = 3000.0  # [1/m]; 6000 makes no difference
    goal_above_clearance: float = 10.0  # times the clearance penalty, at least: more than all zones together


@dataclass(frozen=True)
class AnytimeSettings:
    """Repairs, acceptance of given paths, and predicted times.

    Times apply to the benchmark machine; `CasadiSmoother.warm_up` measures the speed of the present machine. Triples
    are the time without obstacles, the time per nearby obstacle, and the time per metre, obstacle and part of the body.
    """

    certificate_seconds: tuple[float, float, float] = (0.00125, 6e-6, 4e-7)
    iteration_seconds: tuple[float, float, float] = (0.0003, 1e-5, 0.0)
    term_seconds: tuple[float, float] = (1e-4, 6e-5)  # hard terms at the samples of a path, and per metre
    iteration_per_corner: float = 7.5e-7  # [s] per corner of the footprint and interval, an upper bound in nine of ten
    certificate_per_iteration: float = 1.2  # before a certificate is measured
    longest_fades: float = 0.8  # of the longest iteration so far
    iteration_reserve: float = 1.1
    certificate_reserve: float = 1.2
    margin: tuple[float, float] = (0.15, 0.001)  # share of the time limit, and its most [s], after the only certificate
    grace: float = 0.0015  # [s]: by which the predicted end of the only certificate may be late
    latest: float = 0.0005  # [s] after the time limit: a certificate is abandoned
    pace_range: tuple[float, float] = (0.5, 4.0)  # of the measured speed; values beyond are disturbances
    pace_at_warm_up: float = 1.25  # shortest relative to predicted iteration of the warm-up, on that machine
    repairs: int = 2  # of a path that is not certified
    repair_nearest: int = 4  # times the obstacles per interval, at each repair
    repair_buffer: float = 3.0  # times the buffer, at each repair
    repair_finer: int = 2  # times the intervals, where only the bound between nodes is violated ...
    violated_at_poses: float = 0.5  # ... and less than this share of the shortfall occurs at a pose
    nearly: float = 5e-3  # [m]: a smaller shortfall may be due to the bound between nodes and is certified
    nearly_in_sags: float = 2.0  # the same in sags: 5 cm for a car, 3 mm for a robot of 0.9 m
    same_pose: float = 1e-6  # [m, rad], as the certificate's
    on_axis: float = 1e-7  # [m, rad]: tolerance for a straight line
    staging: float = 0.05  # [m] before the final straight: longer lines are optimized


@dataclass(frozen=True)
class Settings:
    """All settings of the method."""

    resolution: ResolutionSettings = ResolutionSettings()
    bounds: BoundSettings = BoundSettings()
    projection: GoalProjectionSettings = GoalProjectionSettings()
    guess: GuessSettings = GuessSettings()
    tracking: TrackingSettings = TrackingSettings()
    collision: CollisionSettings = CollisionSettings()
    step: StepSettings = StepSettings()
    loop: LoopSettings = LoopSettings()
    view: ViewSettings = ViewSettings()
    anytime: AnytimeSettings = AnytimeSettings()

    @cached_property
    def goal_first(self) -> Settings:
        """The settings with a larger penalty on the goal error than on all zones together."""
        chosen = self.view
        goal, share = chosen.goal_penalty, chosen.goal_above_clearance
        return replace(self, loop=replace(self.loop, goal_penalty=goal, goal_above_clearance=share))


DEFAULT_SETTINGS = Settings()
