"""What the tests of the ROS package stand on: a domain of their own, processes that always end, and a client.

Nothing here is left over, however a run ends: every process is a group of its own that is killed at the end of its
fixture, also on ctrl-C, and the kernel kills it where pytest itself is killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import rclpy
import yaml
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from optdock_ros.server import leave, spin
from rclpy.action.client import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

PROGRAMS = Path(sys.prefix) / "bin"
DOMAINS = range(80, 102)  # ids above take ports that Linux hands out to others; people who choose one choose low
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
PATIENCE = 20.0  # [s] for anything that a process should do at once: two cores may be busy with other tests
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


def free_domain() -> tuple[int, socket.socket]:
    """A domain id that no other run on this machine has, and what keeps it: freed by the kernel when the run is gone.

    `ROS_DOMAIN_ID` of the environment is not looked at: it may be that of a robot, which these tests would drive.
    """
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(os.getpid() + offset) % len(DOMAINS)]
        keeper = socket.socket(socket.AF_UNIX)
        try:
            keeper.bind(f"\0optdock-ros-domain-{domain}")
        except OSError:
            keeper.close()
        else:
            return domain, keeper
    raise RuntimeError(f"{len(DOMAINS)} runs of these tests hold all domain ids")


class Process:
    """A console script of this environment, running.

    Args:
        name: Of the script, or a path.
        params: Parameters: a file, taken as it is, or a mapping, given to every node of the process.
        args: Further ROS arguments, for example ("-r", "cmd_vel:=/base/cmd_vel").
        folder: For its parameters and its log.
        env: Environment variables beside those of this process.
    """

    def __init__(
        self,
        name: str,
        params: Path | Mapping[str, object] | None,
        args: Sequence[str],
        folder: Path,
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.name = name
        number = sum(1 for _ in folder.glob("*.log"))
        self.log_file = folder / f"{number:02d}-{Path(name).name}.log"
        command = [str(PROGRAMS / name), "--ros-args", *args]
        if params is not None:
            file = params
            if not isinstance(params, Path):
                file = folder / f"{number:02d}-{Path(name).name}.yaml"
                file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(params)}}))
            command += ["--params-file", str(file)]
        ours = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1", "RCUTILS_COLORIZED_OUTPUT": "0"}
        with self.log_file.open("wb") as log:
            self.popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **ours, **(env or {})},
                start_new_session=True,
                preexec_fn=_die_with_parent,  # noqa: PLW1509 - one system call, no lock is taken
            )

    @property
    def pid(self) -> int:
        """Also the id of its process group."""
        return self.popen.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self.popen.poll() is None

    def log(self) -> str:
        """All that it has said."""
        return self.log_file.read_text(errors="replace")

    def wait_for(self, text: str, timeout: float = PATIENCE) -> None:
        """Until it says `text`; ends the test where it does not, or ends before."""
        end = time.monotonic() + timeout
        while text not in self.log():
            assert self.is_running, f"{self.name} ended ({self.popen.returncode}) without saying {text!r}"
            assert time.monotonic() < end, f"{self.name} did not say {text!r} within {timeout} s"
            time.sleep(0.01)

    def stop(self, by: signal.Signals = signal.SIGINT, timeout: float = PATIENCE) -> int:
        """Send a signal, and the exit code; ends the test where the process goes on."""
        if self.is_running:
            self.popen.send_signal(by)
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.popen.send_signal(signal.SIGABRT)  # the log then shows where every thread of it stands
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(2.0)
            raise AssertionError(f"{self.name} still ran {timeout} s after {by.name}") from None

    def kill(self) -> None:
        """Kill -9 it and all that it started; harmless where nothing runs."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.popen.wait()


class Processes:
    """All processes of a test or a module; called, it starts one. Arguments as `Process`."""

    everywhere: ClassVar[list[Processes]] = []  # of the whole run, for the report of a failure
    grace: ClassVar[float] = 5.0  # [s] between an interrupt and a kill, at the end

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[Process] = []
        self.everywhere.append(self)

    def __call__(
        self,
        name: str,
        params: Path | Mapping[str, object] | None = None,
        args: Sequence[str] = (),
        env: Mapping[str, str] | None = None,
    ) -> Process:
        """Start a console script."""
        process = Process(name, params, args, self.folder, env)
        self.started.append(process)
        return process

    def end(self) -> None:
        """Interrupt all, kill what goes on, and whatever else they left in their groups."""
        for process in self.started:
            if process.is_running:
                process.popen.send_signal(signal.SIGINT)
        end = time.monotonic() + self.grace
        for process in self.started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.popen.wait(max(0.0, end - time.monotonic()))
        for process in self.started:
            process.kill()
        self.everywhere.remove(self)


def _die_with_parent() -> None:
    """In the child: killed by the kernel when the thread that started it is gone."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Reply(NamedTuple):
    """What became of an action's goal.

    Attributes:
        status: Of action_msgs/msg/GoalStatus; None where the goal was not accepted.
        result: The action's result message.
        feedback: All feedback messages, in order.
    """

    status: int | None
    result: Any
    feedback: list[Any]


class Goal:
    """A goal of an action under way."""

    def __init__(self, client: Client, action: ActionClient[Any, Any, Any], goal: Any) -> None:
        self.client = client
        self.feedback: list[Any] = []
        self.handle = client.wait(
            action.send_goal_async(goal, feedback_callback=lambda message: self.feedback.append(message.feedback))
        )
        self.is_accepted = self.handle.accepted
        self._result = self.handle.get_result_async() if self.is_accepted else None

    @property
    def is_done(self) -> bool:
        """Whether the result is there."""
        return self._result is None or self._result.done()

    def cancel(self, timeout: float = PATIENCE) -> Any:
        """Ask for the end, and the answer to that."""
        return self.client.wait(self.handle.cancel_goal_async(), timeout)

    def reply(self, timeout: float = PATIENCE) -> Reply:
        """Wait for the end."""
        if self._result is None:
            return Reply(None, None, self.feedback)
        found = self.client.wait(self._result, timeout)
        return Reply(found.status, found.result, self.feedback)


class Client(Node):
    """A node that spins in a thread of its own, and waits for things.

    Args:
        name: Of the node.
        context: Initialised; None: the default one. A context of its own knows nothing of processes that were killed
            before; others hold them for alive for 20 s, and a service for there.
    """

    def __init__(self, name: str = "test_client", context: rclpy.Context | None = None) -> None:
        super().__init__(name, context=context, start_parameter_services=False)
        self._action_clients_by_name: dict[str, ActionClient[Any, Any, Any]] = {}
        self._clients_by_name: dict[str, Any] = {}
        self._own_executor = SingleThreadedExecutor(context=self.context)
        self._own_executor.add_node(self)
        self._own_thread = threading.Thread(target=spin, args=(self._own_executor,), name=name)
        self._own_thread.start()

    def end(self) -> None:
        """Join the thread, then the node goes: the other way round aborts the interpreter."""
        self._own_executor.create_task(leave)
        self._own_thread.join()
        self._own_executor.shutdown()
        self.destroy_node()

    def wait(self, future: Any, timeout: float = PATIENCE) -> Any:
        """Result of a future that the executor completes; ends the test where it does not come."""
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(timeout), f"no answer within {timeout} s"
        return future.result()

    def until(self, condition: Callable[[], object], timeout: float = PATIENCE, what: str = "it") -> Any:
        """Wait until a condition is true, and its value; ends the test where it does not become so."""
        end = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < end, f"{what} did not happen within {timeout} s"
            time.sleep(0.005)
        return value

    def call(self, kind: Any, name: str, request: Any = None, timeout: float = PATIENCE) -> Any:
        """Call a service."""
        if name not in self._clients_by_name:
            self._clients_by_name[name] = self.create_client(kind, name)
        service = self._clients_by_name[name]
        assert service.wait_for_service(timeout), f"no service {name} within {timeout} s"
        return self.wait(service.call_async(kind.Request() if request is None else request), timeout)

    def send(self, kind: Any, name: str, goal: Any, timeout: float = PATIENCE) -> Goal:
        """Send a goal to an action, and wait until it is accepted or not."""
        if name not in self._action_clients_by_name:
            self._action_clients_by_name[name] = ActionClient(self, kind, name)
        action = self._action_clients_by_name[name]
        assert action.wait_for_server(timeout), f"no action {name} within {timeout} s"
        return Goal(self, action, goal)

    def heard(self, kind: Any, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """A list that every message of a topic is appended to from now on."""
        found: list[Any] = []
        self.create_subscription(kind, topic, found.append, qos)
        return found


class Lifecycle:
    """Walks a managed node through its life by the services of lifecycle_msgs; each says whether it succeeded."""

    def __init__(self, client: Client, node: str) -> None:
        self.client, self.node = client, node.strip("/")

    def configure(self) -> bool:
        """To inactive."""
        return self.change(Transition.TRANSITION_CONFIGURE)

    def activate(self) -> bool:
        """To active."""
        return self.change(Transition.TRANSITION_ACTIVATE)

    def deactivate(self) -> bool:
        """To inactive."""
        return self.change(Transition.TRANSITION_DEACTIVATE)

    def cleanup(self) -> bool:
        """To unconfigured."""
        return self.change(Transition.TRANSITION_CLEANUP)

    def shutdown(self) -> bool:
        """To finalized, from whatever state."""
        return self.change(
            {
                State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
                State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_INACTIVE_SHUTDOWN,
                State.PRIMARY_STATE_ACTIVE: Transition.TRANSITION_ACTIVE_SHUTDOWN,
            }[self._state().id]
        )

    def up(self) -> None:
        """To active, or the test ends."""
        assert self.configure(), f"{self.node}: configure failed"
        assert self.activate(), f"{self.node}: activate failed"

    @property
    def state(self) -> str:
        """Its label: unconfigured, inactive, active, finalized."""
        return str(self._state().label)

    def change(self, transition: int) -> bool:
        """Any transition."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.client.call(ChangeState, f"/{self.node}/change_state", request).success)

    def _state(self) -> State:
        return self.client.call(GetState, f"/{self.node}/get_state").current_state


def flattened(block: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return the dotted names of nested parameters."""
    flat: dict[str, object] = {}
    for name, value in block.items():
        flat |= flattened(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return flat


@contextlib.contextmanager
def ros(domain: int) -> Iterator[None]:
    """`rclpy` initialised for nodes of this process; ctrl-C stays pytest's."""
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def stranger(domain: int) -> Iterator[Client]:
    """A client that has met nobody yet: what to ask a server with that takes the place of a killed one."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    client = Client("stranger", context)
    try:
        yield client
    finally:
        client.end()
        context.try_shutdown()


@contextlib.contextmanager
def spinning(*nodes: Node, executor: Any = None) -> Iterator[None]:
    """Nodes of this process at work in a thread, which is joined; they are destroyed at the end."""
    executor = executor or SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    thread = threading.Thread(target=spin, args=(executor,), name="spinning")
    thread.start()
    try:
        yield
    finally:
        executor.create_task(leave)
        thread.join()
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
