"""Plugin parameters: declaration and validation."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from enum import Enum
from numbers import Real
from typing import TYPE_CHECKING, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["PluginParameters", "checked_seconds", "closest", "invalid_parameters", "parse_parameters"]


class PluginParameters(BaseModel):
    """Base class of plugin parameters. Instances are frozen; unknown names and non-finite numbers are rejected.

    As in ROS, types are not converted, except integers to floats. Fields that exist in Nav2 have Nav2's names and
    defaults. The description of a field contains its unit.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _of_its_own_type(cls, value: object, info: ValidationInfo) -> object:
        annotation = cls.model_fields[str(info.field_name)].annotation
        wanted = {annotation, *get_args(annotation)}
        if wanted & {int, float} and isinstance(value, bool | str | bytes):
            raise ValueError("must be a number")
        if bool in wanted and isinstance(value, int | float | str | bytes) and not isinstance(value, bool):
            raise ValueError("must be true or false")
        return value


P = TypeVar("P", bound=PluginParameters)


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return `; did you mean ...?` with the known name closest to `name`, or the empty string.

    Args:
        name: The unknown name.
        known: The known names.
        cutoff: Least similarity by `difflib`, in [0, 1].

    >>> closest("toleranse", ["tolerance", "step"])
    '; did you mean tolerance?'
    """
    found = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return f"; did you mean {found[0]}?" if found else ""


def checked_seconds(value: object, name: str) -> float:
    """Return a time limit [s] as a float.

    Raises:
        InvalidValue: If the value is not finite, or negative.
    """
    if not (isinstance(value, Real) and math.isfinite(value) and float(value) >= 0.0):
        raise InvalidValue(f"{name}: must be finite and >= 0 s, got {value!r}")
    return float(value)


def parse_parameters(model: type[P], values: Mapping[str, object], owner: str) -> P:
    """Return validated parameters.

    Args:
        model: Class of the parameters.
        values: Names and values, from a file or a caller.
        owner: Name of the plugin, for messages.

    Raises:
        InvalidValue: If `values` is not a mapping, or contains unknown names, wrong types or values out of range; one
            line per fault.
    """
    if type(values) is not dict and not isinstance(values, Mapping):
        raise InvalidValue(f"{owner}: parameters must be a mapping of names to values, got {values!r}")
    # Every plan constructs its plugins with the same values, so immutable parameters are validated only once.
    key: tuple[object, ...] = (model,)
    is_plain = True
    if values:
        is_plain = all(type(value) in _PLAIN for value in values.values())
        key = (model, *((str(name), type(value), repr(value)) for name, value in values.items())) if is_plain else ()
    known = _CHECKED.get(key)
    if isinstance(known, model):
        return known
    try:
        checked = model.model_validate({str(name): value for name, value in values.items()})
    except ValidationError as error:
        raise invalid_parameters(error, model, owner) from error
    if is_plain and _is_constant(checked):
        if len(_CHECKED) >= _MOST_KEPT:
            _CHECKED.clear()
        _CHECKED[key] = checked
    return checked


def invalid_parameters(error: ValidationError, model: type[PluginParameters], owner: str) -> InvalidValue:
    """Return the error for invalid values of a model, one line per fault."""
    return InvalidValue("\n".join(_fault(model, owner, item) for item in error.errors()))


_MOST_KEPT = 256
_CHECKED: dict[tuple[object, ...], PluginParameters] = {}


_PLAIN = (bool, int, float, str, type(None))  # immutable types with distinct representations


def _is_constant(checked: PluginParameters) -> bool:
    """Whether a parameter object can be shared, because it is immutable and depends only on the given values."""
    model = type(checked)
    is_sealed = bool(model.model_config.get("frozen")) and not model.__private_attributes__
    makes_anew = any(spec.default_factory is not None for spec in model.model_fields.values())
    return is_sealed and not makes_anew and all(type(v) in _PLAIN or isinstance(v, Enum) for _, v in checked)


def _fault(model: type[PluginParameters], owner: str, item: Mapping[str, object]) -> str:
    path = item["loc"]
    name = ".".join(str(part) for part in path) if isinstance(path, tuple) else str(path)
    if item["type"] == "extra_forbidden":
        known = (spec.alias or field for field, spec in model.model_fields.items())
        return f"{owner}.{name}: unknown parameter{closest(name.rsplit('.', 1)[-1], known)}"
    where = f"{owner}.{name}" if name else owner
    reason = str(item["msg"]).removeprefix("Value error, ")
    return f"{where}: {reason} (got {item['input']!r})"
