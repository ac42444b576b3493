"""Hypothesis profiles, the clock of budgets, the warm-up of plugins, and where the real inputs live."""

import functools
import gc
import os
from pathlib import Path

# Before NumPy is loaded: on a busy machine the threads of the linear algebra wait for each other, see docs.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import typer.testing
from hypothesis import HealthCheck, settings

from optdock import kernels
from optdock.deadline import set_clock
from optdock.planning import pipeline
from optdock.timing.near_optimal import NearOptimal
from smoothers import CasadiSmoother

# Lazily imported libraries make a first example slow; a deadline would blame the code for it.
settings.register_profile("dev", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

ROOT = Path(__file__).resolve().parents[1]
REAL_DATA = Path(os.environ.get("OPTDOCK_DATA", ROOT.parent / "shared" / "data"))


# Another library of the same kernels, such as one with sanitizers, see .ci/sanitized_kernels.py.
if OTHER_LIBRARY := os.environ.get("OPTDOCK_TEST_LIBRARY"):
    kernels._library = functools.cache(lambda: kernels.load_library(Path(OTHER_LIBRARY), ROOT))


# What a budget allows must not depend on what else the machine does while the tests run.
set_clock("cpu")


def warm_up_installed_plugins_once():
    """Let `plan_dock` warm up every installed plugin once per process, and none that a test makes.

    A warm-up plans a problem for every new combination of classes; `test_pipeline` tests it with plugins of others.
    """
    warm, warmed = pipeline._warm_once, set()

    @functools.wraps(warm)
    def warm_once(planners, smoother, timing):
        fresh = {kind for kind in (*planners, smoother, timing) if is_installed(kind)} - warmed
        if fresh:
            warmed.update(fresh)
            planners = tuple(filter(is_installed, planners))
            smoother, timing = (
                kind if is_installed(kind) else usual
                for kind, usual in ((smoother, CasadiSmoother), (timing, NearOptimal))
            )
            warm(planners, smoother, timing)

    def clear():
        warmed.clear()
        warm.cache_clear()

    warm_once.cache_info, warm_once.cache_clear = warm.cache_info, clear
    pipeline._warm_once = warm_once


def is_installed(kind):
    """Whether a class of plugins belongs to the product."""
    return kind.__module__.partition(".")[0] in ("optdock", "smoothers")


warm_up_installed_plugins_once()


# A runner of commands prepares all commands for every call, which takes longer than most of the calls.
if prepared := getattr(typer.testing, "_get_command", None):
    typer.testing._get_command = functools.cache(prepared)


def pytest_make_parametrize_id(val):
    """Shorten the names of long texts: processes that share the tests send the names of all tests to each other."""
    return f"{val[:40]!r} and more" if isinstance(val, str | bytes) and len(val) > 200 else None


# What is imported and collected stays: garbage collections would look at all of it again and again.
gc.disable()


def pytest_collection_finish():
    """Collect garbage from here on, but not among what was imported, and not after every 700 objects."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)
    gc.enable()


@pytest.fixture(scope="module")
def coarse_pictures():
    """Few pixels, few frames and no arrangement of the parts: what pictures show is tested in `test_plotting.py`."""
    with pytest.MonkeyPatch.context() as patched:
        for module in ("canvas", "animation"):
            patched.setattr(f"optdock.plotting.{module}.DPI", 40)
        patched.setattr("optdock.plotting.animation._MOST_FRAMES", 8)
        patched.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
        yield


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real inputs that are not part of the project; tests that need them skip without it."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"real inputs are not at {REAL_DATA} (set OPTDOCK_DATA)")
    return REAL_DATA
