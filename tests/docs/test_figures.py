"""Figures in the documentation: computed numbers are correct, the others name the command that prints them."""

import importlib
import re
from pathlib import Path

import pytest

import optdock
from experiments.manoeuvres import cases
from tests.docs.snippets import ROOT, measured, not_printed

charts = importlib.import_module("charts")
COUNTED = [(page, one) for page in measured.PAGES for one in measured.counted_in(page)]
MARKED = [one for page in measured.PAGES for one in measured.measured_in(page)]
COMMANDS = sorted({one.command for one in MARKED if one.command})
KNOWN = {"optdock": optdock, "ROOT": ROOT, "cases": cases, "len": len, "sorted": sorted}


def test_figures_are_found():
    assert len(COUNTED) >= 2
    assert len(COMMANDS) >= 2


@pytest.mark.parametrize(
    ("page", "one"), COUNTED, ids=[f"{page.stem}: {one.number} {one.expression}" for page, one in COUNTED]
)
def test_computed_numbers(page, one):
    assert one.number == eval(one.expression, dict(KNOWN)), page


def test_markers_are_valid():
    """A misspelt marker would check nothing."""
    for page in measured.PAGES:
        text = page.read_text(encoding="utf-8")
        assert len(measured.measured_in(page)) == len(re.findall("<!-- *(?:measure|figure)", text)), page


def test_every_table_of_measured_figures_names_its_command():
    page = ROOT / "docs" / "benchmark.md"
    marked = [one.rows for one in measured.measured_in(page)]
    bare = [rows[0] for rows in measured.tables_of(page) if rows not in marked]
    assert bare == []
    by_hand = [one for one in measured.measured_in(page) if one.reason]
    assert all(len(one.reason) > 20 for one in by_hand)


def script_of(command):
    """Return the files of a command."""
    words = command.split()
    name = words[2].replace(".", "/") if words[1] == "-m" else words[1]
    path = ROOT / name
    if path.is_dir():
        chosen = [word for word in words[3:4] if (path / f"{word}.py").is_file()]
        return [path / f"{word}.py" for word in chosen] or sorted(path.glob("*.py"))
    return [path]


@pytest.mark.parametrize(
    "one", [one for one in MARKED if one.command], ids=lambda one: f"{one.command} {one.rows[0][0]}"
)
def test_a_table_has_columns_that_its_command_prints(one):
    """Otherwise nothing would be compared after a rename: the column names must occur in the code."""
    files = script_of(one.command)
    assert files
    assert all(path.is_file() for path in files), files
    code = "\n".join(path.read_text(encoding="utf-8") for path in files)
    assert [name for name in one.rows[0] if f'"{name}"' not in code] == []


def marked(tmp_path, table, command="python -c 0"):
    page = Path(tmp_path) / "page.md"
    page.write_text(f"Text.\n\n<!-- measured: {command} -->\n\n{table}\nMore.\n", encoding="utf-8")
    return measured.measured_in(page)[0]


PRINTED = """p50 / p95 / max of 100 starts

world  method    docked   across, mm       CPU ms
-------------------------------------------------
noisy  law       72/100   5.0 / 12 / 15.5  3.1
noisy  executor  100/100  0.3 / 0.7 / 1.8  2.2

others
world  method    docked   across, mm       CPU ms
-------------------------------------------------
noisy  MPC       99/100   0.1 / 0.2 / 0.3  9.9

1 file written
"""


@pytest.mark.parametrize(
    ("row", "wrong"),
    [
        ("| executor | 100/100 | 0.3 / 0.7 / 1.8 |", ""),
        ("| executor | 100/100 | 0.3 / 0.7 / 1.9 |", ""),  # a unit in the last place
        ("| executor | 100/100 | 0.3 / 0.7 / 0.8 |", "row 2, across, mm: '0.3 / 0.7 / 0.8', printed:"),
        ("| executor | 70/100 | 0.3 / 0.7 / 1.8 |", "row 2, docked"),
        ("| tracker | 100/100 | 0.3 / 0.7 / 1.8 |", "row 2, method"),
        ("| tracker | 72/100 | 5.0 / 12 / 15.5 |\n| law | 1/100 | 1 / 2 / 3 |", "3 rows, printed are 2"),
        ("", ""),  # rows may be omitted
    ],
)
def test_changed_figure_is_found(tmp_path, row, wrong):
    table = marked(
        tmp_path, f"| method | docked | across, mm |\n|---|---|---|\n| law | 72/100 | 5.0 / 12 / 15.5 |\n{row}\n"
    )
    found = measured.compared(table, PRINTED)
    assert bool(found) == bool(wrong), found
    assert not wrong or found[0].startswith(wrong)


def test_missing_table_is_found(tmp_path):
    table = marked(tmp_path, "| method | colour |\n|---|---|\n| law | 1 |\n")
    assert "prints no table with the columns method, colour" in measured.compared(table, PRINTED)[0]


def test_figures_of_computing_time_may_differ_by_a_factor_of_two(tmp_path):
    head = "| method | CPU ms |\n|---|---|\n"
    assert measured.compared(marked(tmp_path, f"{head}| law | 2.0 |\n| executor | 4.0 |\n"), PRINTED) == []
    assert measured.compared(marked(tmp_path, f"{head}| law | 0.02 |\n| executor | 4.0 |\n"), PRINTED) != []


def test_the_text_of_a_study_is_found_among_the_results_if_it_ran_with_these_arguments(tmp_path):
    (tmp_path / "05_contact").mkdir()
    (tmp_path / "05_contact" / "study.md").write_text(PRINTED, encoding="utf-8")
    assert measured.study_of("python experiments/05_contact.py", tmp_path) == PRINTED
    assert measured.study_of("python experiments/05_contact.py --scale 4", tmp_path) is None
    assert measured.study_of("python experiments/06_parking.py", tmp_path) is None


def test_a_line_that_is_not_printed_is_found():
    printed = "off the path   3.42 mm and 0.004 rad\ntube           none"
    assert not_printed("off the path 3.42 mm and 0.004 rad\n...\ntube none", printed) is None
    assert not_printed("off the path 2.68 mm and 0.004 rad", printed) is not None
    assert not_printed("off the road 3.42 mm and 0.004 rad", printed) is not None


@pytest.mark.parametrize("name", sorted(charts.CHARTS))
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_chart_shows_the_table_of_its_page(name, scheme):
    """Draw them again with `python docs/tools/charts.py` if the table has changed."""
    drawn = (charts.ASSETS / f"{name}-{scheme}.svg").read_text(encoding="utf-8")
    assert f"table {charts.digest_of(charts.CHARTS[name][1])}" in drawn
