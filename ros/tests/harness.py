"""The basis of the ROS tests: a separate domain, processes that always end, and a client.

Every process has its own process group, which is killed at the end of its fixture, also on ctrl-C; the kernel kills the
process if pytest itself is killed.
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
from optdock_ros.navigator import answer_of
from optdock_ros.server import leave, spin
from rclpy.action.client import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

PROGRAMS = Path(sys.prefix) / "bin"
DOMAINS = range(80, 102)  # higher ids use ephemeral ports of Linux; users choose low ids
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
PATIENCE = 20.0  # [s] for any reaction of a process on a busy machine
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


def free_domain() -> tuple[int, socket.socket]:
    """Return a domain id that no other run on this machine uses, and the socket that reserves it.

    `ROS_DOMAIN_ID` of the environment is not used: it may be that of a robot, which these tests would drive.
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
    """A running console script of this environment.

    Args:
        name: Name of the script, or a path.
        params: Parameter file, or a mapping of parameters for every node of the process.
        args: Further ROS arguments, for example ("-r", "cmd_vel:=/base/cmd_vel").
        folder: Folder for parameters and log.
        env: Additional environment variables.
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
                preexec_fn=die_with_parent,  # noqa: PLW1509 - one system call, no lock is taken
            )

    @property
    def pid(self) -> int:
        """Id of the process and of its process group."""
        return self.popen.pid

    @property
    def is_running(self) -> bool:
        """Whether the process is running."""
        return self.popen.poll() is None

    def log(self) -> str:
        """Return the log."""
        return self.log_file.read_text(errors="replace")

    def wait_for(self, text: str, timeout: float = PATIENCE) -> None:
        """Wait until the log contains `text`; fail if the process ends before."""
        end = time.monotonic() + timeout
        while text not in self.log():
            assert self.is_running, f"{self.name} ended ({self.popen.returncode}) without logging {text!r}"
            assert time.monotonic() < end, f"{self.name} did not log {text!r} within {timeout} s"
            time.sleep(0.01)

    def stop(self, by: signal.Signals = signal.SIGINT, timeout: float = PATIENCE) -> int:
        """Send a signal and return the exit code; fail if the process does not end."""
        if self.is_running:
            self.popen.send_signal(by)
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.popen.send_signal(signal.SIGABRT)  # the log then contains the stacks of its threads
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(2.0)
            raise AssertionError(f"{self.name} still ran {timeout} s after {by.name}") from None

    def kill(self) -> None:
        """Kill the process group with SIGKILL, if it is running."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.popen.wait()


class Processes:
    """The processes of a test or a module; a call starts one, with the arguments of `Process`."""

    everywhere: ClassVar[list[Processes]] = []  # of the whole run, for reports of failures
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
        """Interrupt all processes, then kill their process groups."""
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


def die_with_parent() -> None:
    """Have the kernel kill this child when its parent thread ends."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Reply(NamedTuple):
    """Status of a goal (None if it was rejected), result message, and feedback messages."""

    status: int | None
    result: Any
    feedback: list[Any]


class Goal:
    """A goal of an action."""

    def __init__(self, client: Client, action: ActionClient[Any, Any, Any], goal: Any) -> None:
        self.client = client
        self.feedback: list[Any] = []
        take = lambda message: self.feedback.append(message.feedback)  # noqa: E731
        self.handle = client.wait(answer_of(client, lambda: action.send_goal_async(goal, feedback_callback=take)))
        self.is_accepted = self.handle.accepted
        self._result = answer_of(client, self.handle.get_result_async) if self.is_accepted else None

    @property
    def is_done(self) -> bool:
        """Whether the result has arrived."""
        return self._result is None or self._result.done()

    def cancel(self, timeout: float = PATIENCE) -> Any:
        """Cancel the goal, and return the answer."""
        return self.client.wait(answer_of(self.client, self.handle.cancel_goal_async), timeout)

    def reply(self, timeout: float = PATIENCE) -> Reply:
        """Return the result."""
        if self._result is None:
            return Reply(None, None, self.feedback)
        found = self.client.wait(self._result, timeout)
        return Reply(found.status, found.result, self.feedback)


class Client(Node):
    """A node that spins in its own thread.

    A new context has no killed processes among its peers; other contexts regard them as alive for 20 s.
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
        """Join the thread, then destroy the node; the reverse order aborts the interpreter."""
        self._own_executor.create_task(leave)
        self._own_thread.join()
        self._own_executor.shutdown()
        self.destroy_node()

    def wait(self, future: Any, timeout: float = PATIENCE) -> Any:
        """Return the result of a future; fail after the timeout."""
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(timeout), f"no answer within {timeout} s"
        return future.result()

    def until(self, condition: Callable[[], object], timeout: float = PATIENCE, what: str = "it") -> Any:
        """Wait until a condition is true and return its value; fail after the timeout."""
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
        """Send a goal to an action, and wait for its acceptance or rejection."""
        if name not in self._action_clients_by_name:
            self._action_clients_by_name[name] = ActionClient(self, kind, name)
        action = self._action_clients_by_name[name]
        assert action.wait_for_server(timeout), f"no action {name} within {timeout} s"
        return Goal(self, action, goal)

    def heard(self, kind: Any, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """Subscribe to a topic, and return the list of its messages."""
        found: list[Any] = []
        self.create_subscription(kind, topic, found.append, qos)
        return found


class Lifecycle:
    """Transitions of a lifecycle node by services; each returns whether it succeeded."""

    def __init__(self, client: Client, node: str) -> None:
        self.client, self.node = client, node.strip("/")

    def configure(self) -> bool:
        """Change to inactive."""
        return self.change(Transition.TRANSITION_CONFIGURE)

    def activate(self) -> bool:
        """Change to active."""
        return self.change(Transition.TRANSITION_ACTIVATE)

    def deactivate(self) -> bool:
        """Change to inactive."""
        return self.change(Transition.TRANSITION_DEACTIVATE)

    def cleanup(self) -> bool:
        """Change to unconfigured."""
        return self.change(Transition.TRANSITION_CLEANUP)

    def shutdown(self) -> bool:
        """Change to finalized, from any state."""
        return self.change(
            {
                State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
                State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_INACTIVE_SHUTDOWN,
                State.PRIMARY_STATE_ACTIVE: Transition.TRANSITION_ACTIVE_SHUTDOWN,
            }[self._state().id]
        )

    def up(self) -> None:
        """Configure and activate; fail otherwise."""
        assert self.configure(), f"{self.node}: configure failed"
        assert self.activate(), f"{self.node}: activate failed"

    @property
    def state(self) -> str:
        """Label of the state: unconfigured, inactive, active or finalized."""
        return str(self._state().label)

    def change(self, transition: int) -> bool:
        """Make a transition."""
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
    """Initialize `rclpy` for nodes of this process, without its signal handlers."""
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def stranger(domain: int) -> Iterator[Client]:
    """Return a client without known peers, for a server that replaces a killed one."""
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
    """Spin nodes of this process in a thread; join it and destroy them at the end."""
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
