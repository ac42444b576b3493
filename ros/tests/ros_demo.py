"""A docking of the simulated robot by the docking server, recorded and drawn: no robot and no ROS installation needed.

    make ros-demo

Robot and server are processes with the parameters of `config/simulated_docking.yaml`, in a ROS domain of their own on
this computer; `examples/dock_and_undock.py` sends the goals. The processes end with the demo, also after an error.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from demo_pictures import draw
from demo_recorder import KEPT, TOPICS, Recorder
from harness import Client, Processes, die_with_parent, free_domain, ros

from optdock.ros.bag import write_bag

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PACKAGE = Path(__file__).resolve().parents[1] / "optdock_ros"
CLIENT = PACKAGE / "examples" / "dock_and_undock.py"
STARTED = 60.0  # [s] until the server is active, on a busy computer
LONGEST = 120.0  # [s] for docking and undocking, which take 20 s
INTERRUPTED = threading.Event()  # by ctrl-C


def wait(condition: Callable[[], object], seconds: float, what: str) -> None:
    """Wait until a condition is true.

    Raises:
        AssertionError: After the given time.
        KeyboardInterrupt: After ctrl-C, whose signal itself raises nothing: callbacks would swallow an exception.
    """
    end = time.monotonic() + seconds
    while not condition():
        if INTERRUPTED.is_set():
            raise KeyboardInterrupt
        assert time.monotonic() < end, f"{what} takes longer than {seconds} s"
        time.sleep(0.05)


def dock(parameters: Path, folder: Path, recording: Path, step: Callable[[str], None]) -> None:
    """Dock, undock, and write the recording.

    Raises:
        AssertionError: If a process fails or takes too long.
        KeyboardInterrupt: After ctrl-C.
    """
    processes, node = Processes(folder), Client("recorder")
    try:
        recorder = Recorder(node)
        # The simulated clock waits for a busy computer; the result does not depend on the load.
        processes("simulated_robot", parameters, ("-p", "speed:=1.0"))
        server = processes("docking_server", parameters, ("-p", "use_sim_time:=true", "-p", "autostart:=true"))
        wait(lambda: "active" in server.log() or not server.is_running, STARTED, "the start of the server")
        step(f"simulated_robot and docking_server are active in ROS domain {os.environ['ROS_DOMAIN_ID']}")
        step(f"{CLIENT.name} docks and undocks: about 20 s")
        # As the servers in a session of its own, which ctrl-C does not interrupt.
        client = subprocess.Popen(
            [sys.executable, str(CLIENT)],
            start_new_session=True,
            preexec_fn=die_with_parent,  # noqa: PLW1509 - one system call, no lock is taken
        )
        try:
            wait(lambda: client.poll() is not None, LONGEST, CLIENT.name)
        finally:
            client.kill()
        assert client.returncode == 0, f"{CLIENT.name} ended with {client.returncode}"
        write_bag(recording, recorder.messages, KEPT)
        step(f"written: {recording}, {len(recorder.messages)} messages on {len(TOPICS)} topics")
    except AssertionError:
        for process in processes.started:
            sys.stderr.write(f"--- log of {process.name}\n{process.log()}")
        raise
    finally:
        node.end()
        processes.end()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return 1 if it fails, 130 after ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("ros-demo"), help="folder (default: %(default)s)")
    parser.add_argument("--params", type=Path, default=PACKAGE / "config" / "simulated_docking.yaml")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, lambda *_: INTERRUPTED.set())
    options.out.mkdir(parents=True, exist_ok=True)
    recording, began = options.out / "docking.mcap", time.monotonic()

    def step(text: str) -> None:
        print(f"[{time.monotonic() - began:4.0f} s] {text}", flush=True)

    domain, keeper = free_domain()
    with keeper, tempfile.TemporaryDirectory() as folder:
        ours = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OMP_NUM_THREADS": "1"}
        os.environ.update(ours, ROS_LOG_DIR=folder)
        try:
            with ros(domain):
                dock(options.params, Path(folder), recording, step)
            for line in draw(recording, options.params, options.out):
                step(line)
        except KeyboardInterrupt:
            print("interrupted; the processes have ended", file=sys.stderr)
            return 130
        except AssertionError as error:
            print(f"the demo failed: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
