"""Fixtures of the tests of experiments."""

import pytest

from optdock.deadline import set_clock


@pytest.fixture(autouse=True)
def budgets_count_cpu_time_again():
    """Commands of experiments choose the clock of their process, which is that of later tests here."""
    yield
    set_clock("cpu")
