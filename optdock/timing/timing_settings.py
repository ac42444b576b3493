"""Every tuned constant of the time parameterization, with its reason: one frozen object for each method.

Unless a field says otherwise it was tuned with `python -m experiments.benchmarks timing`, whose tables show duration
over the jerk-limited optimum, CPU time and paths that end beyond a limit, for the committed suites and for fresh random
paths. Tolerances of rounding are not tuned; they stand where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = [
    "CLOCK",
    "NEAR_OPTIMAL",
    "SAMPLING",
    "WINDOWED",
    "EndArcs",
    "InitialGuess",
    "InteriorPoint",
    "Knots",
    "Margins",
    "MoveSettings",
    "NearOptimalSettings",
    "Strategy",
    "WindowedSettings",
]


@dataclass(frozen=True)
class Sampling:
    """How finely paths and motions are looked at, by both methods; the proof decides in the end.

    Attributes:
        clothoid_spacing: Between nodes [m]: a clothoid is exact between them, they only carry the checks.
        polyline_spacing: Likewise of a polyline, whose curvature is that between its poses.
        most_nodes: Of one segment.
        check_period: Of the dense check [s].
        check_refinement: Times finer where a limit is nearly used up.
        braking_period: Of full braking [s].
        most_samples: Of one motion, 320 kB a column: slower motions are sampled more coarsely, never in more memory.
        longest_motion: One that takes longer is refused, as memory and time grow with it [s].
    """

    clothoid_spacing: float = 0.005
    polyline_spacing: float = 0.002
    most_nodes: int = 6000
    check_period: float = 0.008
    check_refinement: int = 16
    braking_period: float = 0.004
    most_samples: int = 40_000
    longest_motion: float = 3600.0


@dataclass(frozen=True)
class Clock:
    """What is kept of a deadline for the sure end of a call; tuned with `experiments/benchmarks/timing_proofs.py`.

    Two are multiples of the time that looking up the curvature of the path took, which knows path and machine: over
    the paths of the benchmark the windowed method takes 3 and the proof 7 in the median, the quickest proof 4.

    Attributes:
        windows_and_proof: With less left the search for a faster motion ends.
        proof: With less left no motion is worth beginning.
        refusal: Within which an impossible request is refused [s].
    """

    windows_and_proof: float = 10.0
    proof: float = 4.0
    refusal: float = 0.02


@dataclass(frozen=True)
class WindowedSettings:
    """The windowed method.

    Attributes:
        max_window: Longest window [m].
        cap_ratio: Largest quotient of two speed caps within a window.
        yaw_share: Share of the turning limits left to the curvature rate; the rest is for accelerating in a bend.
        margin: Share of the speed caps left unused: curvature between the nodes of a curve that is not a clothoid.
    """

    max_window: float = 1.0
    cap_ratio: float = 1.2
    yaw_share: float = 0.8
    margin: float = 1e-3


@dataclass(frozen=True)
class Margins:
    """Shares of the limits that the near-optimal method leaves unused.

    Attributes:
        speed: Of the speed caps, in the reference: room for the corners that ruckig cuts.
        yaw: Of the yaw acceleration, in the reference; of other turning limits likewise, as powers of the speed.
        jerk: Of the jerk, in the reference.
        drive: Of acceleration and deceleration, in the reference: ruckig refuses a state beyond them.
        check: Of the speed caps, when moves are accepted; twice that of the yaw acceleration.
        relieved_speed: Of the speed caps where full braking from a moving start leaves no room for `speed`.
        relieved_yaw: Likewise of the yaw acceleration.
        jump: Of the yaw acceleration: smaller jumps of v^2 * rate are left to these margins.
        cap_jump: Of a speed cap: likewise, smaller jumps of what the steering rate allows.
    """

    speed: float = 0.003
    yaw: float = 0.02
    jerk: float = 0.015
    drive: float = 0.003
    check: float = 0.001
    relieved_speed: float = 1e-4
    relieved_yaw: float = 1e-3
    jump: float = 0.004
    cap_jump: float = 0.001


@dataclass(frozen=True)
class EndArcs:
    """Arcs of constant jerk between rest and the reference.

    Attributes:
        drive_share: Of the acceleration and of the yaw acceleration that an arc may use.
        speed_share: Of the local cap that an arc and its mirror image reach.
        length_share: Of the segment.
        slow_share: Of the local cap: below it a moving start is launched too.
        hold: A start with v = 0, a > 0 first holds its acceleration for so long [s].
        least_rest: Share of the segment that both arcs must leave to the reference.
    """

    drive_share: float = 0.7
    speed_share: float = 0.6
    length_share: float = 0.1
    slow_share: float = 0.25
    hold: float = 0.1
    least_rest: float = 0.1


@dataclass(frozen=True)
class Knots:
    """Where the reference has its knots.

    Attributes:
        jump: Share of the yaw acceleration: smaller jumps of v^2 * rate need no knot, nor do those of a speed cap.
        crowded: Jumps per shortest step: beyond it no knot is put on any of them.
        least_step: Share of the step: jumps closer together share a cell.
        least_cells: Of a reference.
        cruise_density: Knots per knot elsewhere, where the profile stays level.
        cruise_level: Least over largest v^2 of a level stretch.
        cruise_yaw: Share of the yaw acceleration: more needs the knots.
        cruise_sample: Spacing of the samples that must be level [s].
        cruise_reach: So many of them to either side.
    """

    jump: float = 0.02
    crowded: float = 0.5
    least_step: float = 0.4
    least_cells: int = 8
    cruise_density: float = 0.5
    cruise_level: float = 0.96
    cruise_yaw: float = 0.6
    cruise_sample: float = 0.06
    cruise_reach: int = 8


@dataclass(frozen=True)
class InitialGuess:
    """The first iterate, from the filtered acceleration-limited profile.

    Attributes:
        sample: Of the filter [s].
        share: Of the filtered v^2: inside the limits.
        blend: From the speed of a moving start [s].
    """

    sample: float = 0.02
    share: float = 0.9
    blend: float = 0.6


@dataclass(frozen=True)
class InteriorPoint:
    """Iterations; the margins are larger than what they leave.

    Attributes:
        most_iterations: Then the last iterate is taken; it is a motion whatever it breaks.
        gap: Of duality, relative to the objective.
        residual: Of every bound, relative.
        freeze: Iterations after which the factor of the jerk rows stays: updating it for ever converges linearly.
        to_boundary: Share of the way to the next bound that a step takes.
        largest_decrease: Share that a coefficient loses in one step.
        smallest_slack: At the start: rows broken by the first iterate must not start on their bound.
        first_gap: Times the objective.
        centering: Steps longer than the first of a pair let the next target gap be this share of the present one,
        short_centering: shorter ones this share.
    """

    most_iterations: int = 40
    gap: float = 1e-2
    residual: float = 6e-3
    freeze: int = 8
    to_boundary: float = 0.99
    largest_decrease: float = 0.9
    smallest_slack: float = 0.2
    first_gap: float = 0.2
    centering: tuple[tuple[float, float], ...] = ((0.85, 0.08), (0.4, 0.25))
    short_centering: float = 0.6


@dataclass(frozen=True)
class MoveSettings:
    """ruckig's moves along the reference.

    Attributes:
        sample: Of the check of a move [s].
        longest_factor: A move may take so many times as long as the reference,
        longest_more: and so much longer [s].
        gentle_below: Shorter pieces are tried with hardly more than the reference's own jerk and drive first [s].
        gentle_jerk: Factor on the largest jerk of the reference, and share of the limit added to it.
        gentle_most_jerk: Share of the limit: with more a gentle move has no advantage.
        gentle_drive: Factor on the reference's range of accelerations, and share of the limit added to it.
        gentle_least_drive: Share of the acceleration that a gentle move has at least.
        level: Share of the largest v^2: where the cap stays above, one move may do for any length.
        middle: Cells: longer pieces are cut at once into parts of at most so many,
        short: longer ones than this into four, the others in two.
    """

    sample: float = 0.02
    longest_factor: float = 1.2
    longest_more: float = 0.05
    gentle_below: float = 1.5
    gentle_jerk: tuple[float, float] = (1.05, 0.01)
    gentle_most_jerk: float = 0.95
    gentle_drive: tuple[float, float] = (1.04, 0.04)
    gentle_least_drive: float = 0.01
    level: float = 0.8
    middle: int = 16
    short: int = 6


@dataclass(frozen=True)
class Strategy:
    """Which method is tried, and when the next one.

    Attributes:
        single_move_below: Longer segments are not tried with one move [m].
        tiny: Segments too short for a reference: slower single moves are tried [m].
        slower_moves: Shares of the speed, and of acceleration and deceleration, of these.
        single_move_spare: They are stretched by this more than needed: the check samples.
        hopeless: A reference so many times slower than caps and drive ask for was not solved: where no spline keeps the
            limits the iterations end anywhere, and samples of a motion of weeks fill any memory. Solved ones stay
            below 4.
        longest_reference: Its knots grow with the duration, its gain over windows does not [s].
        most_knots: Of a reference: a few MB, and 10 ms for an iteration.
        relief: Margins: a moving start whose braking is closer to the limits gets none there.
        stretch_at_once: Up to this factor stretching time is better than another attempt.
        stretch_at_last: Beyond it the windowed method may be better.
        retries: Attempts under tightened limits.
        longest_retried: Longer motions take 0.3 s and more for every attempt; they are stretched or windowed [s].
        tightened_around: On both sides of a bad stretch [m].
        tightened_more: Beyond the excess.
        least_tightening: Least factor on the speeds.
    """

    single_move_below: float = 1.0
    tiny: float = 0.08
    slower_moves: tuple[tuple[float, float], ...] = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.25, 0.5), (0.25, 0.25))
    single_move_spare: float = 1.0005
    hopeless: float = 10.0
    longest_reference: float = 150.0
    most_knots: int = 5000
    relief: float = 3.0
    stretch_at_once: float = 1.012
    stretch_at_last: float = 1.1
    retries: int = 2
    longest_retried: float = 60.0
    tightened_around: float = 0.06
    tightened_more: float = 0.006
    least_tightening: float = 0.3


@dataclass(frozen=True)
class NearOptimalSettings:
    """The near-optimal method, chapter by chapter.

    Attributes:
        step: Knot spacing of the reference [s].
        smooth: Whether the reference itself is the motion.
        jerk_step_price: Of a full swing of the jerk between cells of the reference [s]: a little saves a sixth of the
            moves for 0.01 % of time.
        smooth_jerk_step_price: Likewise where the reference is the motion.
        tight_yaw: Share of a turning limit: a start beyond it is planned without margins until it is below.
        margins: What is left unused.
        arcs: Launch and stop.
        knots: Of the reference.
        guess: First iterate.
        interior_point: Solver.
        moves: By ruckig.
        strategy: Methods and retries.
    """

    step: float = 0.08
    smooth: bool = False
    jerk_step_price: float = 0.002
    smooth_jerk_step_price: float = 0.1
    tight_yaw: float = 0.95
    margins: Margins = field(default_factory=Margins)
    arcs: EndArcs = field(default_factory=EndArcs)
    knots: Knots = field(default_factory=Knots)
    guess: InitialGuess = field(default_factory=InitialGuess)
    interior_point: InteriorPoint = field(default_factory=InteriorPoint)
    moves: MoveSettings = field(default_factory=MoveSettings)
    strategy: Strategy = field(default_factory=Strategy)


SAMPLING = Sampling()
CLOCK = Clock()
WINDOWED = WindowedSettings()
NEAR_OPTIMAL = NearOptimalSettings()
