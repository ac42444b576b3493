"""Functions of cases, in a module that every worker can import."""

import os
import signal
import time
from pathlib import Path

from optdock.deadline import Deadline, clock_name, now


def squared(number, pause=0.0):
    time.sleep(pause)
    return {"square": number * number, "share": number / 7.0}


def failing(number):
    if number % 3 == 1:
        raise ValueError(f"{number}\n is not wanted")
    return (number, [])


def killing(number, folder, often):
    """Kill the own process in the first `often` calls of case 2; the number of its calls is counted in files."""
    if number == 2:
        calls = len(list(Path(folder).iterdir()))
        if calls < often:
            (Path(folder) / str(calls)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return number


def clock_of_case(readings):
    """Return the clock, its first time, and after how many readings a second has passed."""
    first, deadline = now(), Deadline(1.0)
    time.sleep(0.02)
    passed = next(k for k in range(10**9) if deadline.passed() or k == readings)
    return [clock_name(), first, passed]


def overlapping(folder):
    """Whether another case is in this process at the same time."""
    mine = Path(folder) / str(os.getpid())
    try:
        mine.touch(exist_ok=False)
    except FileExistsError:
        return True
    time.sleep(0.02)
    mine.unlink()
    return False


def not_json(number):
    return {"set": {number}} if number else float("nan")


def process_of_case(number, pause):
    time.sleep(pause)
    return [number, os.getpid()]


class Counted:
    """An object that counts how often it is restored in this process."""

    restored = 0

    def __setstate__(self, state):
        type(self).restored += 1


def restored(_, number):
    """Return the process, and how often the shared object has been restored in it."""
    return [number, os.getpid(), Counted.restored]


def planned(problem, *start):
    """Return the digest of a plan and its counted times."""
    from optdock.geometry.pose import Pose2  # the other functions need no libraries
    from optdock.planning.pipeline import plan_dock

    plan = plan_dock(problem.starting_at(Pose2(*start)), time_budget=0.1)
    return [plan.path.digest, plan.timing_ms]
