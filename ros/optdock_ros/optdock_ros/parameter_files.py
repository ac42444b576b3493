"""The blocks of the parameter files of a process, and whether any of them is for a node.

rcl ignores the blocks of other nodes without a message, also of nodes that differ in their namespace only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml

from optdock.errors import OptdockError
from optdock.io.guarded_file import MostBytes, read_text

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

__all__ = ["FileBlock", "blocks_of", "missing_parameters"]


class FileBlock(NamedTuple):
    """File, node (a full name, or a pattern with `*` and `**`) and names of the parameters of a block."""

    file: str
    node: str
    names: frozenset[str]

    def is_for(self, node: str) -> bool:
        """Whether the block is for a node, given by its full name."""
        pattern = re.escape(self.node).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
        return re.fullmatch(pattern, node) is not None


def blocks_of(arguments: Sequence[str]) -> list[FileBlock]:
    """Return the blocks of all files that follow `--params-file` on a command line."""
    files = [value for flag, value in pairwise(arguments) if flag == "--params-file"]
    found: list[FileBlock] = []
    for file in files:
        with suppress(OptdockError, yaml.YAMLError):  # rcl reports it
            found += _blocks(file, "", yaml.safe_load(read_text(Path(file), MostBytes.YAML)))
    return found


def _blocks(file: str, path: str, value: object) -> Iterator[FileBlock]:
    for key, inner in value.items() if isinstance(value, Mapping) else ():
        if key == "ros__parameters":
            names = inner if isinstance(inner, Mapping) else ()
            yield FileBlock(file, path, frozenset(str(name).partition(".")[0] for name in names))
        else:
            yield from _blocks(file, f"{path}/{str(key).strip('/')}", inner)


def missing_parameters(
    blocks: Collection[FileBlock], node: str, known: Collection[str], shared: Collection[str]
) -> tuple[str, bool]:
    """Return why no block has parameters of a node, and whether the node has some in another namespace.

    Args:
        blocks: Blocks of all files.
        node: Full name of the node.
        known: Names of parameters of the node; the other names in a block for all nodes do not count.
        shared: Names that do not count, because they are set for every node.

    Returns:
        The reason; empty if there are parameters or no files.
    """
    name = node.rpartition("/")[2]
    own = [block for block in blocks if block.names - set(shared)]
    named = [block for block in own if block.node.rpartition("/")[2] == name]
    if not own or any(block.is_for(node) for block in own if block in named or block.names & set(known)):
        return "", False
    files = ", ".join(sorted({block.file for block in named or own}))
    return f"{files}: has no parameters of {node}, but of {', '.join(sorted({b.node for b in named or own}))}", bool(
        named
    )
