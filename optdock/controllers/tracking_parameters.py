"""Parameters of the tracking controller."""

from __future__ import annotations

from pydantic import Field

from optdock.plugins.parameters import PluginParameters

__all__ = ["TrackingControllerParameters"]


class TrackingControllerParameters(PluginParameters):
    """Gains, time base and finish of the TrackingController."""

    period: float | None = Field(
        default=None, gt=0.0, description="time between two calls [s]; None: measured from their stamps"
    )
    along_gain: float = Field(default=2.0, gt=0.0, description="speed per error along the travel [1/s]")
    convergence_distance: float = Field(
        default=0.25, gt=0.0, description="distance over which lateral errors decay, longer for late drives [m]"
    )
    damping: float = Field(default=1.0, gt=0.0, description="damping ratio of the lateral error")
    turn_gain: float = Field(default=1.0, gt=0.0, description="least yaw rate per heading error [1/s]")
    preview: float | None = Field(
        default=None, ge=0.0, description="the drive's latency plus lag, compensated [s]; None: estimated on the way"
    )
    slow_down_lag: float = Field(default=0.002, ge=0.0, description="lag at which the reference begins to wait [m]")
    stop_lag: float = Field(default=0.1, gt=0.0, description="lag at which the reference stands still [m]")
    turn_reserve: float = Field(
        default=0.06, ge=0.0, lt=0.5, description="share of max_yaw_acceleration left to feedback by slowing down [1]"
    )
    max_error: float = Field(default=0.5, gt=0.0, description="distance from the reference that ends the task [m]")
    max_yaw_error: float = Field(default=0.8, gt=0.0, description="heading error that ends the task [rad]")
    min_speed: float = Field(default=0.0, ge=0.0, description="smallest speed the drive executes, for the finish [m/s]")
    min_yaw_rate: float = Field(default=0.0, ge=0.0, description="smallest yaw rate it executes [rad/s]")
    finish_tolerance: float = Field(default=0.002, gt=0.0, description="the smallest speed is used beyond this [m]")
    finish_yaw_tolerance: float = Field(default=0.005, gt=0.0, description="as finish_tolerance, for yaw [rad]")
    patience: float = Field(
        default=3.0, gt=0.0, description="time without progress, on the way or at the end, after which it gives up [s]"
    )
    use_collision_detection: bool = Field(default=True, description="look for obstacles on the way to a stop")
    collision_tolerance: float = Field(
        default=0.01, ge=0.0, description="how deep noise and a pressed bumper may show the station [m]"
    )
    time_parameterizer: str = Field(default="NearOptimal", description="plugin that times a path handed over untimed")
