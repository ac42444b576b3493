"""The parameters of the docking and smoother servers in a Nav2 file, and their use in optdock."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.nav2.controller_settings import controller_settings, inner_block, named_blocks
from optdock.nav2.declared_parameters import NAV2_DOCKS, OURS, Block, Use, found, names_of
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from optdock.nav2.params import Nav2Params

__all__ = ["nav2_parameter_rows", "refused_parameters"]

_UNKNOWN = "not in Nav2"
_OURS = "of optdock"


def nav2_parameter_rows(params: Nav2Params) -> list[tuple[str, str, str]]:
    """Return rows of node, use, and parameter with the reason; parameters that are read share a row."""
    rows: list[tuple[str, str, str]] = []
    for node, values in params.nodes.items():
        told = list(_told(node, values))
        for use in (Use.READ.value, _OURS):
            names = [name for name, kind, _ in told if kind == use]
            if names:
                rows.append((node, use, ", ".join(names)))
        others = [one for one in told if one[1] not in {Use.READ.value, _OURS}]
        rows += [(node, kind, f"{name}: {words}" if words else name) for name, kind, words in others]
    return rows


def refused_parameters(values: Mapping[str, object]) -> list[str]:
    """Return one line for every parameter of a docking server that is refused with any value except false.

    Values of the block `controller` are refused by `controller_settings`.
    """
    types = named_blocks(values, "dock_plugins")
    blocks = [("", Block.DOCKING, values), *((f"{name}.", Block.DOCK_TYPE, own) for name, own in types.items())]
    return [
        f"{prefix}{name}: {row.words.replace('`', '')}"
        for prefix, block, own in blocks
        for name in own
        if (row := found(block, name)) is not None and row.use is Use.REFUSED and own[name] is not False
    ]


def _told(node: str, values: Mapping[str, object]) -> Iterator[tuple[str, str, str]]:
    """Return name, use and reason of the parameters of a node; empty for nodes that optdock does not replace."""
    name = node.rsplit("/", 1)[-1]
    if name == "docking_server" or "dock_plugins" in values:
        yield from _docking(values)
    elif name == "smoother_server" or "smoother_plugins" in values:
        smoothers = named_blocks({"smoother_plugins": ["simple_smoother"], **values}, "smoother_plugins")
        yield from _of_block(Block.SMOOTHING, values, "", skipped=smoothers)


def _docking(values: Mapping[str, object]) -> Iterator[tuple[str, str, str]]:
    types, docks = named_blocks(values, "dock_plugins"), named_blocks(values, "docks")
    yield from _of_block(Block.DOCKING, values, "", skipped=(*types, *docks, "controller"))
    controller = inner_block(values, "controller")
    yield from _of_block(Block.CONTROLLER, controller, "controller.", effects=_effects(values))
    for name, own in types.items():
        if str(own.get("plugin", "")).replace("/", "::") in NAV2_DOCKS:
            yield from _of_block(Block.DOCK_TYPE, own, f"{name}.")
    for name, own in docks.items():
        yield from _of_block(Block.DOCK, own, f"{name}.")


def _of_block(
    block: Block,
    values: Mapping[str, object],
    prefix: str,
    *,
    skipped: Iterable[str] = (),
    effects: Mapping[str, tuple[str, str]] | None = None,
) -> Iterator[tuple[str, str, str]]:
    """Return name, use and reason of the parameters of one block; `effects`: the effects that depend on the value."""
    ours = (*OURS.get(block, ()), *OURS[Block.ANY_NODE])
    for name in (str(key) for key in values if key not in set(skipped)):
        row = found(block, name)
        if effects and name in effects:
            yield f"{prefix}{name}", *effects[name]
        elif name in ours:
            yield f"{prefix}{name}", _OURS, ""
        elif row is not None:
            use = Use.NO_EFFECT if row.use is Use.REFUSED and values[name] is False else row.use
            yield f"{prefix}{name}", use.value, row.words.replace("`", "")
        else:
            hint = closest(name, {*names_of(block), *ours}).removeprefix("; ")
            yield f"{prefix}{name}", _UNKNOWN, hint


def _effects(server: Mapping[str, object]) -> dict[str, tuple[str, str]]:
    """Return use and reason of the parameters in the block `controller` that set other settings."""
    return {
        name: ((Use.REFUSED if one.is_refused else Use.MAPPED if one.values else Use.NO_EFFECT).value, one.words)
        for name, one in controller_settings(server).items()
    }
