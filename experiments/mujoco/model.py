"""MuJoCo model of a robot and its docking station.

A `Robot` defines outline and limits; a `Chassis` defines mass, wheels and bumper stiffness. This module does not need
MuJoCo: the result is text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from importlib.resources import files
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import number
from optdock.geometry.polygon import signed_area
from optdock.model.robot import Drive

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.model.dock import Dock
    from optdock.model.robot import Robot

__all__ = ["Chassis", "docking_model"]

_RIGHT_ANGLE = 1e-9  # largest cosine of a right angle: a rectangle becomes a box, whose contacts are exact
_CASTER = 0.03  # [m], radius
_CASTER_SHARE = 0.3  # of the weight; the tyres carry the rest, which determines their grip
_SAG = 0.005  # [m], deflection of the casters' springs under that weight: stiff enough for little pitch
_GRAVITY = 9.81  # [m/s^2], as in the model file
_SERVO_TIME = 0.01  # [s], time constant of the wheel speed servo; slower drives have an `Actuation`
# Inertia of motor and gear at the wheel, relative to that of half the robot: usual for geared motors. A wheel that is
# much lighter than its servo is stiff would slip in every acceleration, because MuJoCo computes contact forces without
# the servo.
_ROTOR_SHARE = 0.1
_LEAST_RESTITUTION = 0.14  # just over exp(-2)
_STALL = 3.0  # ratio to the force of the largest acceleration: the usual reserve of a drive


@dataclass(frozen=True)
class Chassis:
    """Physical properties of a robot in addition to its outline and limits.

    Args:
        area_density: Mass of the body per area of the outline [kg/m^2]; 100: 30 kg for 0.6 m x 0.5 m.
        mass: Mass of the body [kg]; None: by area density.
        track_width: Distance between the wheels [m]; None: that of the limits, or 0.8 of the outline's width if they
            have none.
        wheel_radius: [m].
        wheel_torque: Largest torque at either wheel [N m]; None: three times the torque of the largest acceleration or
            deceleration of the limits.
        tyre_friction: Coefficient of friction between tyre and floor [1]; rubber on a smooth floor.
        caster_friction: Coefficient of friction of the casters, which models their rolling resistance [1].
        bumper_friction: Coefficient of friction between robot and station [1]; plastic on metal.
        bumper_stiffness: Contact force per depth between robot and station [N/m]. Peaks of the contact force scale with
            its square root; 1e5 is a rubber pad of 5 cm^2, 20 mm thick, with a modulus of 4 MPa.
        restitution: Ratio of the speeds after and before a bounce [1]; at least 0.14, that of critical damping.
        bumper: Lower and upper edge of the body that touches the station [m].

    Raises:
        InvalidValue: If a value is not finite and > 0 (frictions: >= 0), the restitution is not in [0.14, 1), or the
            bumper's upper edge is not above the lower one.
    """

    area_density: float = 100.0
    mass: float | None = None
    track_width: float | None = None
    wheel_radius: float = 0.075
    wheel_torque: float | None = None
    tyre_friction: float = 0.8
    caster_friction: float = 0.02
    bumper_friction: float = 0.3
    bumper_stiffness: float = 1e5
    restitution: float = 0.3
    bumper: tuple[float, float] = (0.1, 0.2)

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = getattr(self, spec.name)
            if value is None or spec.name == "bumper":
                continue
            may_vanish = spec.name.endswith("friction")
            checked = number(value, f"chassis.{spec.name}")
            if not (math.isfinite(checked) and (checked > 0.0 or (may_vanish and checked == 0.0))):
                rule = "finite and >= 0" if may_vanish else "finite and > 0"
                raise InvalidValue(f"chassis.{spec.name}: must be {rule}, got {value}")
        if not _LEAST_RESTITUTION <= self.restitution < 1.0:
            raise InvalidValue(f"chassis.restitution: must be in [{_LEAST_RESTITUTION}, 1), got {self.restitution}")
        low, high = (number(value, "chassis.bumper") for value in self.bumper)
        if not 0.0 < low < high < math.inf:
            raise InvalidValue(
                f"chassis.bumper: must be two heights above the floor, the lower one first, got {self.bumper}"
            )

    def track_of(self, robot: Robot) -> float:
        """Return the distance between the wheels of `robot` [m]."""
        return self.track_width or robot.limits.track_width or 0.8 * robot.footprint.width

    def mass_of(self, robot: Robot) -> float:
        """Return the mass of the body of `robot` [kg]; its wheels and casters add 1.4 kg."""
        return self.mass or self.area_density * float(signed_area(robot.footprint.vertices))

    def torque_of(self, robot: Robot) -> float:
        """Return the largest torque at either wheel of `robot` [N m]."""
        hardest = max(robot.limits.max_acceleration, robot.limits.max_deceleration)
        return self.wheel_torque or 0.5 * _STALL * self.mass_of(robot) * hardest * self.wheel_radius


def docking_model(robot: Robot, dock: Dock, chassis: Chassis | None = None) -> str:
    """Return the model of `robot` in front of the station of `dock`, as a MuJoCo model file (MJCF).

    Args:
        robot: A differential drive.
        dock: Dock with an immovable station; without a footprint there is no station.
        chassis: Masses, wheels, bumper; None: the default.

    Raises:
        InvalidValue: If the robot is no differential drive, or its outline has no room for casters before or behind its
            axle.
    """
    if robot.drive is not Drive.DIFFERENTIAL:
        raise InvalidValue(f"mujoco: the model is a differential drive, the robot's drive is {robot.drive.value}")
    chassis = chassis or Chassis()
    template = files(__package__) / "models" / "differential_drive.xml"
    model = _Model(template.read_text(encoding="utf-8"))
    _write_wheels(model, robot, chassis)
    _write_casters(model, robot, chassis)
    low, high = chassis.bumper
    mass = chassis.mass_of(robot)
    density = mass / (float(signed_area(robot.footprint.vertices)) * (high - low))
    model.add_prisms("robot", robot.footprint, (low, high), {"class": "outline", "density": repr(density)})
    damping_ratio = _damping_ratio(chassis.restitution)
    stiffness = chassis.bumper_stiffness / mass
    model.set_default(
        "outline",
        solref=_words(-stiffness, -2.0 * damping_ratio * math.sqrt(stiffness)),
        friction=_words(chassis.bumper_friction, 0.0, 0.0),
    )
    model.set("body", "station", pos=_words(dock.pose.x, dock.pose.y, 0.0), euler=_words(0.0, 0.0, dock.pose.yaw))
    if dock.footprint is not None:
        model.add_prisms("station", dock.footprint, (low - 0.05, high + 0.05), {"class": "station"})
    return model.text()


def _write_wheels(model: _Model, robot: Robot, chassis: Chassis) -> None:
    """Write tyres and motors."""
    radius, half_track = chassis.wheel_radius, 0.5 * chassis.track_of(robot)
    torque = chassis.torque_of(robot)
    inertia = 0.5 * chassis.mass_of(robot) * radius**2  # of half the robot, at a wheel
    gain = inertia / _SERVO_TIME
    for side, y in (("left", half_track), ("right", -half_track)):
        model.set("body", f"{side} wheel", pos=_words(0.0, y, radius))
        model.set("joint", f"{side} wheel", armature=_words(_ROTOR_SHARE * inertia))
        model.set(
            "geom", f"{side} tyre", size=_words(radius, 0.02, radius), friction=_words(chassis.tyre_friction, 0, 0)
        )
        model.set("velocity", f"{side} wheel", kv=_words(gain), forcerange=_words(-torque, torque))


def _write_casters(model: _Model, robot: Robot, chassis: Chassis) -> None:
    """Write casters at both ends, on preloaded springs, so that the robot stands level."""
    import shapely

    ends = robot.footprint.vertices[:, 0]
    front, rear = float(ends.max()) - _CASTER, float(ends.min()) + _CASTER
    if front < _CASTER or rear > -_CASTER:
        raise InvalidValue("mujoco: the robot's outline must extend 6 cm before and behind its axle, to the casters")
    weight = _GRAVITY * chassis.mass_of(robot)
    ahead = float(shapely.Polygon(robot.footprint.vertices).centroid.x)
    loads = {"front": weight * (ahead - _CASTER_SHARE * rear) / (front - rear)}
    loads["rear"] = _CASTER_SHARE * weight - loads["front"]
    stiffness = 0.5 * _CASTER_SHARE * weight / _SAG
    damping = math.sqrt(0.5 * stiffness * chassis.mass_of(robot))  # half of the critical damping
    for end, x in (("front", front), ("rear", rear)):
        model.set("body", f"{end} caster", pos=_words(x, 0.0, _CASTER))
        spring = {
            "stiffness": _words(stiffness),
            "damping": _words(damping),
            "springref": _words(-loads[end] / stiffness),
        }
        model.set("joint", f"{end} caster", **spring)
        model.set("geom", f"{end} caster", friction=_words(chassis.caster_friction, 0, 0))


def _damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a linear spring and damper with this coefficient of restitution [1].

    Contact ends when the force vanishes, before the spring is relaxed [Schwager2007]; the ratio is found by bisection.
    """
    low, high = 0.0, 1.0
    while high - low > 1e-12:
        ratio = 0.5 * (low + high)
        swing = math.sqrt(1.0 - ratio**2)
        until_apart = math.pi - math.atan2(2.0 * ratio * swing, 1.0 - 2.0 * ratio**2)
        low, high = (ratio, high) if math.exp(-until_apart * ratio / swing) > restitution else (low, ratio)
    return high


class _Model:
    """Template of a model file."""

    def __init__(self, text: str) -> None:
        self._root = ElementTree.fromstring(text)

    def set(self, kind: str, name: str, **attributes: str) -> None:
        """Set attributes of the element of this kind and name."""
        found = self._root.find(f".//{kind}[@name='{name}']")
        assert found is not None, f"the model file has no {kind} {name}"
        found.attrib.update(attributes)

    def set_default(self, name: str, **attributes: str) -> None:
        """Set attributes of all geoms of a class."""
        found = self._root.find(f".//default[@class='{name}']/geom")
        assert found is not None, f"the model file has no class {name}"
        found.attrib.update(attributes)

    def add_prisms(
        self, body: str, outline: Footprint, heights: tuple[float, float], attributes: dict[str, str]
    ) -> None:
        """Add the convex pieces of an outline, from the lower to the upper height [m], as geoms of a body."""
        parent, assets = self._root.find(f".//body[@name='{body}']"), self._root.find("asset")
        assert parent is not None
        assert assets is not None
        for i, piece in enumerate(outline.bodies):
            name = f"{body} {i}"
            shape = _box(piece.vertices, heights)
            if not shape:
                corners = [(x, y, z) for z in heights for x, y in piece.vertices.tolist()]
                ElementTree.SubElement(assets, "mesh", name=name, vertex=_words(*(c for row in corners for c in row)))
                shape = {"type": "mesh", "mesh": name}
            ElementTree.SubElement(parent, "geom", {"name": name, **attributes, **shape})

    def text(self) -> str:
        """Return the text of the file."""
        ElementTree.indent(self._root)
        return ElementTree.tostring(self._root, encoding="unicode")


def _box(vertices: FloatArray, heights: tuple[float, float]) -> dict[str, str]:
    """Return the attributes of a rectangular piece as a box; empty for other pieces."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    sides = np.hypot(edges[:, 0], edges[:, 1])
    if (
        len(vertices) != 4
        or np.max(np.abs(np.sum(edges * np.roll(edges, 1, axis=0), axis=1))) > _RIGHT_ANGLE * sides.max() ** 2
    ):
        return {}
    (x, y), half_height = vertices.mean(axis=0).tolist(), 0.5 * (heights[1] - heights[0])
    return {
        "type": "box",
        "size": _words(*(0.5 * sides[:2]).tolist(), half_height),
        "pos": _words(x, y, heights[0] + half_height),
        "euler": _words(0.0, 0.0, math.atan2(edges[0, 1], edges[0, 0])),
    }


def _words(*values: float) -> str:
    """Return numbers in the format of the file, with full precision."""
    return " ".join(repr(float(value)) for value in values)
