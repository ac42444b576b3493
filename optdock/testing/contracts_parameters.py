"""Parameters as a contract sees them: their names in files, which are numbers, and changes that are accepted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.lifecycle import Plugin
    from optdock.parameters import PluginParameters

__all__ = ["accepted_changes", "accepts", "float_names", "known_names"]


def known_names(parameters: PluginParameters) -> tuple[str, ...]:
    """The names that a file or a caller uses: the alias where there is one."""
    return tuple(spec.alias or name for name, spec in type(parameters).model_fields.items())


def float_names(parameters: PluginParameters) -> tuple[str, ...]:
    """Names of the parameters that hold a real number now."""
    return tuple(name for name, value in parameters.model_dump(by_alias=True).items() if isinstance(value, float))


def accepts(plugin: Plugin, name: str, value: object) -> bool:
    """Whether the plugin takes this value; it has it then."""
    try:
        plugin.set_parameters(**{name: value})
    except InvalidValue:
        return False
    return True


def accepted_changes(make_plugin: Callable[[], Plugin]) -> dict[str, object]:
    """For every number and switch that can be changed alone, a value other than the present one that is accepted."""
    found: dict[str, object] = {}
    for name, value in make_plugin().parameters.model_dump(by_alias=True).items():
        for candidate in _others(value):
            if accepts(make_plugin(), name, candidate):
                found[name] = candidate
                break
    return found


def _others(value: object) -> Sequence[object]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return (value + 1, value - 1, value + 2, value - 2)
    if isinstance(value, float):
        return (1.25 * value, 0.8 * value, value + 0.1, value - 0.1) if value else (0.1, -0.1)
    return ()
