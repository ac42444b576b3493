"""Figures of `smooth_path`: round trip, cancel, memory and threads; server and client are two processes.

    .venv-ros/bin/python ros/tests/bench_smooth_path.py [--goals 1000] [--round-trips 300] [--plugin CasadiSmoother]

200 poses among 20 obstacles, a costmap of 400 x 400 cells. Bars: round trip p50 <= 25 ms, p99 <= 60 ms; a cancellation
is answered within 20 ms; 1,000 goals in a row add at most 5 MB and no thread.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hall import Surroundings, message, raw_path
from harness import Client, Lifecycle, Processes, free_domain, ros
from nav2_msgs.action import SmoothPath

if TYPE_CHECKING:
    from collections.abc import Callable

BARS = {"round trip p50": 25.0, "round trip p99": 60.0, "cancel": 20.0, "growth": 5.0}


def memory(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024.0


def threads(pid: int) -> int:
    """Return the number of threads of a process."""
    return len(list(Path(f"/proc/{pid}/task").iterdir()))


def cpu(pid: int) -> float:
    """Return the CPU time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Start a server, measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=1000)
    parser.add_argument("--round-trips", type=int, default=300)
    parser.add_argument("--plugin", default="CasadiSmoother")
    asked = parser.parse_args()
    domain, keeper = free_domain()
    os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder, keeper, ros(domain):
        processes = Processes(Path(folder))
        client = Client("bench")
        try:
            parameters = {"smoother_plugins": ["bench"], "bench": {"plugin": asked.plugin}}
            server = processes("smoother_server", parameters)
            Lifecycle(client, "smoother_server").up()
            world = Surroundings(client)
            world.costmap()
            world.footprint()
            time.sleep(0.5)
            measure(client, server.pid, asked)
        finally:
            print(server.log()[-2000:]) if not server.is_running else None
            client.end()
            processes.end()


def measure(client: Client, pid: int, asked: argparse.Namespace) -> None:
    """Print all measurements."""
    goal = SmoothPath.Goal(path=message(raw_path()), check_for_collisions=True)
    goal.max_smoothing_duration.sec = 3

    def _round_trip() -> float:
        began = time.perf_counter()
        reply = client.send(SmoothPath, "smooth_path", goal).reply()
        assert reply.result.error_code == 0, reply.result.error_msg
        assert reply.result.was_completed
        return 1e3 * (time.perf_counter() - began)

    def _cancel(after: float) -> float:
        running = client.send(SmoothPath, "smooth_path", goal)
        time.sleep(after)
        began = time.perf_counter()
        running.cancel()
        took = 1e3 * (time.perf_counter() - began)
        running.reply()
        return took

    print(f"{asked.plugin}: 200 poses among 20 obstacles, costmap 400 x 400; load {os.getloadavg()[0]:.1f}")
    for _ in range(20):
        _round_trip()
    gc.freeze()  # collections of this process are none of the server's
    cpu_began, own_began = cpu(pid), time.process_time()
    times = np.array([_round_trip() for _ in range(asked.round_trips)])
    share = 1e3 * (cpu(pid) - cpu_began) / len(times), 1e3 * (time.process_time() - own_began) / len(times)
    tell("round trip p50", float(np.percentile(times, 50)), "ms")
    tell("round trip p99", float(np.percentile(times, 99)), "ms")
    print(f"  {'CPU per round trip':24s} server {share[0]:.1f} ms, client {share[1]:.1f} ms")
    cancels = np.array([_cancel(0.001 * (n % 15)) for n in range(60)])
    print(f"  {'cancel p50':24s} {np.percentile(cancels, 50):8.1f} ms")
    tell("cancel", float(cancels.max()), "ms at most")
    leaks(_round_trip, pid, asked.goals)


def leaks(round_trip: Callable[[], float], pid: int, goals: int) -> None:
    """Measure memory and threads over many goals."""
    # Results are kept for 10 s: only then does what comes equal what goes.
    end = time.monotonic() + (13.0 if goals > 1 else 0.0)
    while time.monotonic() < end:
        round_trip()
    before, used = memory(pid), threads(pid)
    middle = 0.0
    for n in range(goals):
        round_trip()
        middle = memory(pid) if n == goals // 2 else middle
    after = memory(pid)
    print(f"  {'memory':24s} {before:.1f} MB, after {goals // 2}: {middle:.1f}, after {goals}: {after:.1f}")
    tell("growth", after - before, "MB")
    print(f"  {'threads':24s} {used} before, {threads(pid)} after")


def tell(name: str, value: float, unit: str) -> None:
    """Print a measurement and its limit."""
    print(f"  {name:24s} {value:8.1f} {unit}, bar {BARS[name]:g}: {'kept' if value <= BARS[name] else 'NOT KEPT'}")


if __name__ == "__main__":
    main()
