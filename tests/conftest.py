"""Hypothesis profiles, the clock of budgets, and where the real inputs live."""

import os
from pathlib import Path

# Before NumPy is loaded: on a busy machine the threads of the linear algebra wait for each other, see docs.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

from experiments.cpu_budgets import count_cpu

# Lazily imported libraries make a first example slow; a deadline would blame the code for it.
settings.register_profile("dev", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

ROOT = Path(__file__).resolve().parents[1]
REAL_DATA = Path(os.environ.get("OPTDOCK_DATA", ROOT.parent / "shared" / "data"))


# What a budget allows must not depend on what else the machine does while the tests run.
count_cpu()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real inputs that are not part of the project; tests that need them skip without it."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"real inputs are not at {REAL_DATA} (set OPTDOCK_DATA)")
    return REAL_DATA
