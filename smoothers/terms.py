"""Terms of `CasadiSmoother`: a user's own costs and constraints along a path, as CasADi expressions.

A term is a scalar expression of the symbols of a point of the path and of the term's own parameters:

| symbol | meaning |
|---|---|
| `x`, `y` | position [m] |
| `yaw` | heading, in [-pi, pi) [rad] |
| `curvature` | d yaw / d s [1/m]; in turns in place 1e9 with the sign of the turn |
| `s` | distance driven from the start of the path [m] |
| `remaining` | distance left to drive to the goal [m] |
| `gear` | 1 forward, -1 in reverse, 0 in turns in place |

Turns in place cover no distance, so `s` and `remaining` are constant in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number, instance, non_negative
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Callable

    import casadi

__all__ = ["SYMBOLS", "HardTerm", "PathPoint", "PathTerm", "SoftTerm", "TermFunction"]

SYMBOLS = ("x", "y", "yaw", "curvature", "s", "remaining", "gear")

_Term = TypeVar("_Term", bound="PathTerm")


class PathPoint:
    """Symbols of a point of a path, and the parameters of a term, as attributes of type `casadi.SX`."""

    x: casadi.SX
    y: casadi.SX
    yaw: casadi.SX
    curvature: casadi.SX
    s: casadi.SX
    remaining: casadi.SX
    gear: casadi.SX

    def __init__(self, symbols: dict[str, casadi.SX]) -> None:
        vars(self).update(symbols)

    def __getattr__(self, name: str) -> casadi.SX:
        raise AttributeError(f"there is no symbol or parameter {name!r}{closest(name, vars(self))}")


@dataclass(frozen=True, eq=False)
class TermFunction:
    """Expression of a term, without the values of its parameters."""

    # Of the symbols, Shape (7,), and the parameters: the value, and a number that is not finite if an argument of a
    # comparison, a minimum, or another function that can hide NaN is not finite: fmin(1, NaN) is 1.
    function: casadi.Function
    reads: frozenset[str]  # names of the symbols on which the value depends


class PathTerm:
    """Base class of terms, which are immutable.

    Args:
        name: Name of the term in results and errors.
        expression: Function that receives the symbols and parameters as a `PathPoint` and returns a scalar `casadi.SX`.
            It is called once, in the constructor.
        **values: Values of the parameters, finite numbers, which are attributes of the `PathPoint`.

    Attributes:
        name: Name of the term.
        function: The expression.

    Raises:
        InvalidValue: If a parameter has the name of a symbol or is not a finite number, or the expression raises an
            exception, uses an unknown symbol, or does not return a scalar `casadi.SX`.
    """

    def __init__(self, name: str, expression: Callable[[PathPoint], casadi.SX], /, **values: float) -> None:
        self.name = instance(str, name, "term: name")
        self._values: dict[str, float] = self._checked(values)
        self.function = _function_of(self.name, expression, list(self._values))

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name."""
        return dict(self._values)

    def with_values(self: _Term, /, **values: float) -> _Term:
        """Return the term with other values of the named parameters; its functions are not built again.

        Raises:
            InvalidValue: If the term has no parameter of that name, or a value is not a finite number.
        """
        unknown = next((name for name in values if name not in self._values), None)
        if unknown is not None:
            raise InvalidValue(f"term {self.name!r}: has no parameter {unknown!r}{closest(unknown, self._values)}")
        changed = object.__new__(type(self))
        vars(changed).update(vars(self), _values=self._checked({**self._values, **values}))
        return changed

    def __repr__(self) -> str:
        listed = "".join(f", {name}={value:g}" for name, value in self._values.items())
        return f"<{type(self).__name__} {self.name!r}{listed}>"

    def _checked(self, values: dict[str, float]) -> dict[str, float]:
        taken = next((name for name in values if name in SYMBOLS), None)
        if taken is not None:
            raise InvalidValue(f"term {self.name!r}: parameter {taken!r}: has the name of a symbol")
        return {name: finite_number(value, f"term {self.name!r}: {name}") for name, value in values.items()}


class HardTerm(PathTerm):
    """Constraint `expression >= 0` along the whole path, turns in place and the final straight included.

    The value should change by about 1 if the robot moves by 1 m, like a distance in metres. The constraint is
    linearized in the search, and checked at samples of every path that is returned: it is sampled, not proven.
    """


class SoftTerm(PathTerm):
    """Cost `weight * expression^2`, integrated over the driven length without the final straight.

    The expression is a residual, whose square is approximated by Gauss-Newton. `casadi.fmax(0, expression)` gives a
    cost on one side only.

    Args:
        name: As in `PathTerm`.
        expression: As in `PathTerm`.
        weight: Cost per metre of a residual of 1, >= 0 [1/m]; the cost of the length itself is 1 per metre.
        **values: As in `PathTerm`.
    """

    def __init__(
        self, name: str, expression: Callable[[PathPoint], casadi.SX], /, *, weight: float = 1.0, **values: float
    ) -> None:
        super().__init__(name, expression, **values)
        self.weight = non_negative(weight, f"term {self.name!r}: weight", "1/m")

    def with_weight(self, weight: float) -> SoftTerm:
        """Return the term with another weight [1/m].

        Raises:
            InvalidValue: If the weight is not a finite number >= 0.
        """
        changed = self.with_values()
        changed.weight = non_negative(weight, f"term {self.name!r}: weight", "1/m")
        return changed


def _function_of(name: str, expression: Callable[[PathPoint], casadi.SX], parameters: list[str]) -> TermFunction:
    import casadi

    if not callable(expression):
        raise InvalidValue(f"term {name!r}: the expression must be a function of a PathPoint, got {expression!r}")
    symbols = {one: casadi.SX.sym(one) for one in (*SYMBOLS, *parameters)}
    try:
        found = expression(PathPoint(symbols))
    except Exception as error:  # code of users may raise any exception
        raise InvalidValue(f"term {name!r}: {type(error).__name__}: {error}") from error
    found = _scalar(name, found)
    point = casadi.vertcat(*(symbols[one] for one in SYMBOLS))
    values = casadi.vertcat(casadi.SX(0, 1), *(symbols[one] for one in parameters))
    free = sorted({one.name() for one in casadi.symvar(found)} - set(symbols))
    try:
        function = casadi.Function("term", [point, values], [found, _hidden(found)])
    except RuntimeError as error:
        what = ", ".join(free) or "symbols of another term"
        rule = "use the attributes of the PathPoint, and declare parameters by name"
        raise InvalidValue(f"term {name!r}: depends on {what}: {rule}") from error
    return TermFunction(function, frozenset(one.name() for one in casadi.symvar(found)) & frozenset(SYMBOLS))


def _hidden(expression: casadi.SX) -> casadi.SX:
    """Return a sum of the arguments of all functions in an expression that can return a number for NaN."""
    import casadi

    hiding = {casadi.OP_FMIN, casadi.OP_FMAX, casadi.OP_LT, casadi.OP_LE, casadi.OP_EQ, casadi.OP_NE, casadi.OP_NOT}
    hiding |= {casadi.OP_AND, casadi.OP_OR, casadi.OP_COPYSIGN, casadi.OP_POW, casadi.OP_CONSTPOW}
    known: dict[int, casadi.SX] = {}
    left = [expression]
    while left:
        node = left[-1]
        parts = [node.dep(i) for i in range(node.n_dep())]
        missing = [part for part in parts if part.element_hash() not in known]
        left.extend(missing)
        if missing:
            continue
        left.pop()
        sums = [known[part.element_hash()] for part in parts]
        if parts and node.op() == casadi.OP_IF_ELSE_ZERO:  # a branch that is not taken may have no value
            sums = [*sums, parts[0]]
            sums[1] = casadi.if_else(parts[0], sums[1], 0.0)
        elif parts and node.op() in hiding:
            sums += parts
        known[node.element_hash()] = sum(sums, casadi.SX(0.0))
    return known[expression.element_hash()]


def _scalar(name: str, found: object) -> casadi.SX:
    """Return an expression as a dense scalar."""
    import casadi

    if isinstance(found, int | float) and not isinstance(found, bool):
        found = casadi.SX(found)
    if not isinstance(found, casadi.SX | casadi.DM):
        raise InvalidValue(f"term {name!r}: must return a casadi.SX, got {type(found).__name__}")
    if found.shape != (1, 1):
        raise InvalidValue(f"term {name!r}: must return a scalar, got a matrix of shape {found.shape}")
    scalar = casadi.densify(casadi.SX(found))
    if scalar.is_constant() and not scalar.is_regular():
        raise InvalidValue(f"term {name!r}: returns {float(scalar)}, must be finite")
    return scalar
