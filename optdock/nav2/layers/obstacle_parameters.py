"""Parameters of the ObstacleLayer and of its observation sources, as Nav2's files give them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field, field_validator, model_validator

from optdock.costmap.costs import NO_INFORMATION
from optdock.nav2.layers.base import LayerParameters
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from optdock.costmap.costs import CostArray

__all__ = ["CombinationMethod", "ObstacleLayerParameters", "SourceParameters", "combined"]


class CombinationMethod(IntEnum):
    """Nav2's numbers."""

    OVERWRITE = 0
    MAX = 1
    MAX_WITHOUT_UNKNOWN_OVERWRITE = 2


def combined(master: CostArray, layer: CostArray, method: CombinationMethod) -> CostArray:
    """The master's costs after a layer of the same shape; where the layer knows nothing the master stays.

    OVERWRITE takes the layer's cost, MAX the higher one and the layer's where the master is unknown,
    MAX_WITHOUT_UNKNOWN_OVERWRITE the higher one and leaves the master's unknown cells.
    """
    is_known = layer != NO_INFORMATION
    if method is CombinationMethod.OVERWRITE:
        return np.where(is_known, layer, master)
    is_unknown = master == NO_INFORMATION
    wins = is_known & (layer > master)
    if method is CombinationMethod.MAX:
        wins |= is_known & is_unknown
    return np.where(wins, layer, master)


class SourceParameters(PluginParameters):
    """Nav2's parameters of one observation source."""

    marking: bool = Field(default=True, description="points become obstacles")
    clearing: bool = Field(default=False, description="lines of sight become free")
    obstacle_max_range: float = Field(default=2.5, ge=0.0, description="points from here on are not marked [m]")
    obstacle_min_range: float = Field(default=0.0, ge=0.0, description="points nearer than this are not marked [m]")
    raytrace_max_range: float = Field(default=3.0, ge=0.0, description="clearing ends here [m]")
    raytrace_min_range: float = Field(default=0.0, ge=0.0, description="clearing begins here [m]")
    inf_is_valid: bool = Field(default=False, description="beams without return clear")
    observation_persistence: float = Field(default=0.0, ge=0.0, description="how long it is used; 0: once [s]")
    expected_update_rate: float = Field(default=0.0, ge=0.0, description="longest silence while current; 0: any [s]")


class ObstacleLayerParameters(SourceParameters, LayerParameters):
    """Nav2's parameters of the ObstacleLayer.

    The parameters of its only source stand beside the layer's or, as in Nav2's files, in a block of the name that
    `observation_sources` holds. With several names every source has its own block; what is missing there is taken
    from beside the layer's. `track_unknown_space` is True here, False in Nav2.
    """

    track_unknown_space: bool = Field(default=True, description="cells never seen are unknown; False: free")
    footprint_clearing_enabled: bool = Field(default=True, description="free the cells under the robot")
    combination_method: CombinationMethod = Field(
        default=CombinationMethod.MAX, description="0 overwrite, 1 max, 2 max_without_unknown_overwrite"
    )
    observation_sources: str = Field(default="", description="names of the sources, separated by spaces")
    sources: Mapping[str, SourceParameters] = Field(
        default_factory=dict, description="the sources by name; empty where there is but one"
    )

    graph_names: ClassVar[frozenset[str]] = frozenset(
        {"topic", "sensor_frame", "data_type", "transform_tolerance", "tf_filter_tolerance", "transport_type"}
        | {"min_obstacle_height", "max_obstacle_height"}
    )

    @model_validator(mode="before")
    @classmethod
    def _read_sources(cls, values: object) -> object:
        """The blocks of the sources: one is spread out beside the layer's own, several become `sources`."""
        given = values.get("observation_sources") if isinstance(values, Mapping) else None
        if not isinstance(values, Mapping) or not isinstance(given, str):
            return values
        names = given.split()
        twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
        if twice:
            raise ValueError(f"observation_sources: names {twice[0]} more than once")
        blocks = {name: values[name] for name in names if isinstance(values.get(name), Mapping)}
        flat = {name: value for name, value in values.items() if name not in blocks}
        if len(names) == 1:
            return {**flat, **cls.without_graph_names(blocks.get(names[0], {}))}
        if names and "sources" not in flat:
            shared = {name: value for name, value in flat.items() if name in SourceParameters.model_fields}
            flat["sources"] = {name: {**shared, **cls.without_graph_names(blocks.get(name, {}))} for name in names}
        return flat

    @field_validator("combination_method", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        names = {method.name.lower(): method for method in CombinationMethod}
        if value.lower() not in names:
            raise ValueError(f"must be one of {', '.join(names)}, or 0, 1, 2")
        return names[value.lower()]
