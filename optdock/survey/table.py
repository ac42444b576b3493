"""The cells of a survey as a Parquet file.

| column | content |
|---|---|
| `robot`, `dock` | names |
| `x`, `y`, `yaw` | centre of the cell [m, m, rad] |
| `verdict` | `certified`, `impossible`, `not_found`, or `occupied`: the robot overlaps or touches an obstacle |
| `answer` | `planned`; `deformed` from the motion of a neighbour; `inherited`: a certified motion passes the cell;
  `shared`: answer of the nearest answered cell of the block; `proven`: impossible; `measured`: occupied |
| `seconds`, `cusps`, `margin` | duration [s], stops on the way, least clearance beyond the required one [m] |
| `start_x`, `start_y`, `start_yaw` | pose at which the motion of the answer begins [m, m, rad] |
| `source` | row of the cell whose motion or proof answers this cell, among the rows of this dock; -1 if there is none |
| `reason` | reason of a refusal |
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.errors import MissingExtra
from optdock.io.atomic_file import replacing
from optdock.survey.rounds import CellState

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.survey.rounds import SurveyAnswers

__all__ = ["columns_of", "require_parquet", "save_table"]


def require_parquet() -> Any:  # noqa: ANN401 - a module without types
    """Return the module that writes Parquet files.

    Raises:
        MissingExtra: If it is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise MissingExtra("a survey needs pyarrow: pip install 'optdock[survey]'") from error
    return pyarrow


def columns_of(answers: SurveyAnswers) -> dict[str, FloatArray | IntArray | list[str]]:
    """Return the columns of the surveyed cells, without robot and dock."""
    rows = np.flatnonzero(answers.verdict > CellState.UNKNOWN)
    row_of = np.full(answers.verdict.size, -1)
    row_of[rows] = np.arange(rows.size)
    centre, start, source = answers.grid.poses(rows), answers.start[rows], answers.source[rows]
    margins = {cell: np.nan if one.margin is None else one.margin for cell, one in answers.asked.items()}
    refused = {cell: one.reason for cell, one in answers.asked.items() if one.verdict != "certified"}
    return {
        **dict(zip(("x", "y", "yaw"), centre.T, strict=True)),
        "verdict": [CellState(value).name.lower() for value in answers.verdict[rows].tolist()],
        "answer": answers.method[rows].tolist(),
        "seconds": answers.seconds[rows],
        "cusps": np.where(np.isfinite(answers.seconds[rows]), answers.stops[rows], -1),
        "margin": np.array([margins.get(cell, np.nan) for cell in source.tolist()]),
        **dict(zip(("start_x", "start_y", "start_yaw"), start.T, strict=True)),
        "source": np.where(source >= 0, row_of[source], -1),
        "reason": [refused.get(cell, "") for cell in source.tolist()],
    }


def save_table(target: Path, docks: Sequence[tuple[str, str, SurveyAnswers]]) -> None:
    """Write the cells of docks, given with the names of robot and dock.

    Raises:
        MissingExtra: If pyarrow is not installed.
        InvalidFile: If the file cannot be written.
    """
    pyarrow = require_parquet()
    tables = []
    for robot, dock, answers in docks:
        columns = columns_of(answers)
        named = {"robot": [robot] * len(columns["x"]), "dock": [dock] * len(columns["x"]), **columns}
        arrays = {name: pyarrow.array(column) for name, column in named.items()}
        texts = {name for name, array in arrays.items() if pyarrow.types.is_string(array.type)}
        tables.append(
            pyarrow.table({name: a.dictionary_encode() if name in texts else a for name, a in arrays.items()})
        )
    with replacing(target) as temporary:
        pyarrow.parquet.write_table(pyarrow.concat_tables(tables).unify_dictionaries(), temporary)
