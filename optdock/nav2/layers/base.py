"""What Nav2's layers share: the switch that turns them off, and names that mean something on a ROS graph only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field, model_validator

from optdock.plugins.interfaces import Layer
from optdock.plugins.parameters import PluginParameters

__all__ = ["LayerParameters", "SwitchedLayer"]


class LayerParameters(PluginParameters):
    """Base of the layers' parameters.

    Nav2's names that mean something on a ROS graph only (topics, transforms, threads) are accepted and dropped, so
    that a block of a Nav2 parameter file can be passed as it is.
    """

    enabled: bool = Field(default=True, description="whether the layer takes part")

    graph_names: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="before")
    @classmethod
    def _drop_graph_names(cls, values: object) -> object:
        return cls.without_graph_names(values) if isinstance(values, Mapping) else values

    @classmethod
    def without_graph_names(cls, values: Mapping[str, object]) -> dict[str, object]:
        """`values` without the names that mean something on a ROS graph only."""
        return {name: value for name, value in values.items() if name not in cls.graph_names}


class SwitchedLayer(Layer):
    """A layer with the parameter `enabled`."""

    Parameters = LayerParameters
    parameters: LayerParameters

    def is_enabled(self) -> bool:
        """Parameter `enabled`."""
        return self.parameters.enabled
