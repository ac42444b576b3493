"""Attributes that are computed at their first use."""

from __future__ import annotations

import functools
from typing import TypeVar, overload

__all__ = ["cached_property"]

_T_co = TypeVar("_T_co", covariant=True)


class cached_property(functools.cached_property[_T_co]):  # noqa: N801 - named as the property that it replaces
    """`functools.cached_property` without its lock.

    Before Python 3.12, all instances share one lock, which threads wait for, and a first use takes twice as long. Here
    two threads may both compute a value, which must therefore be the same in both.
    """

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> cached_property[_T_co]: ...
    @overload
    def __get__(self, instance: object, owner: type | None = None) -> _T_co: ...
    def __get__(self, instance: object, owner: type | None = None) -> cached_property[_T_co] | _T_co:
        if instance is None:
            return self
        assert self.attrname is not None
        value = self.func(instance)
        instance.__dict__[self.attrname] = value  # read from now on, because this descriptor has no `__set__`
        return value
