"""The base of the servers: lifecycle, parameters, and the start and end of a server's process.

All parameters of a server are validated together into one frozen value, `Server.settings`: at configure, where all
faults are reported, and at every later change, which is applied as a whole or not at all. Work in progress continues
with the settings at its beginning.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import sys
import threading
import time
import traceback
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

from optdock.errors import InvalidValue, OptdockError
from optdock.nav2.declared_parameters import Block, names_of
from optdock.plugins.parameters import parse_parameters
from optdock_ros.bond import Bond
from optdock_ros.nested_parameters import BlockReader, ServerParameters, declare, declare_overrides, parameters_of
from optdock_ros.parameter_files import FileBlock, blocks_of, missing_parameters

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.executors import Executor
    from rclpy.parameter import Parameter

__all__ = ["Server", "run"]

S = TypeVar("S")

_SWITCH = 0.0005  # [s] instead of Python's 5 ms, so that a calculating thread soon yields to the control loop
_ANSWERS = 0.1  # [s] between the end of the work and that of the node, in which clients fetch the last results
_PATIENCE = 10.0  # [s] for the last transitions of a process, as long as a lifecycle manager waits


class Server(LifecycleNode, Generic[S]):
    """A lifecycle node with the parameters of a Nav2 server.

    A subclass validates its parameters (`check`), makes and destroys its interfaces (`set_up`, `tear_down`), and begins
    and ends its work (`start`, `stop`). Each method may raise; the transition then fails, everything that was made is
    destroyed, and the reason is logged.

    Attributes:
        settings: Result of `check`; set from configure to cleanup.
        is_active: Whether the node is active.
        owns_process: Whether the node is the only one of the process; set by `run`.
        files: Blocks of the parameter files of the process; set by `run`.
    """

    Parameters: ClassVar[type[ServerParameters]] = ServerParameters
    place: ClassVar[Block] = Block.ANY_NODE
    """Place of the node's parameters in the table of Nav2's parameters."""
    fixed: ClassVar[frozenset[str]] = frozenset()
    """Names of parameters and blocks that cannot be changed while configured."""

    settings: S

    def __init__(
        self,
        name: str,
        *,
        namespace: str | None = None,
        parameter_overrides: Sequence[Parameter[Any]] = (),
    ) -> None:
        given = list(parameter_overrides)
        super().__init__(
            name,
            namespace=namespace,
            parameter_overrides=given,
            allow_undeclared_parameters=True,  # a plugin that is set later has additional parameters
        )
        declare_overrides(self, given)
        declare(self, self.Parameters)
        self.owns_process = False
        self.files: list[FileBlock] = []
        self._has_begun = False  # whether there is something to tear down
        self._is_configured = False
        self.is_active = False
        self._logged: frozenset[str] = frozenset()
        self._bond: Bond | None = None
        self.add_on_set_parameters_callback(self._validate_change)
        self.add_post_set_parameters_callback(self._apply_change)

    # Methods for subclasses.

    def check(self, block: dict[str, object]) -> S:
        """Return all parameters, a nested block, as one frozen value.

        Raises:
            OptdockError: If a parameter is invalid; one line per fault.
        """
        raise NotImplementedError

    def set_up(self) -> None:
        """Create subscriptions, publishers and action servers according to `settings`."""

    def start(self) -> None:
        """Begin to work."""

    def stop(self) -> None:
        """End all work; also called after `start` has failed."""

    def tear_down(self) -> None:
        """Destroy what `set_up` created; also called after `set_up` has failed."""

    def changed(self) -> None:
        """React to new `settings` of a configured node."""

    def own_parameters(self, block: dict[str, object], blocks: Sequence[str] = ()) -> ServerParameters:
        """Return the validated parameters of `Parameters`, and log ignored names at the top; `blocks` are other names.

        Raises:
            InvalidValue: If values are invalid or names misspelt; one line per fault.
        """
        fields = {spec.alias or name for name, spec in self.Parameters.model_fields.items()}
        own = {name: value for name, value in block.items() if name in fields}
        reader = BlockReader(block)
        reader.known(block, {*fields, *blocks}, self.place)
        parsed = reader.attempt(lambda: parse_parameters(self.Parameters, own, self.get_name()), None)
        reader.check()
        assert parsed is not None
        self.log_ignored(reader.ignored)
        return parsed

    def log_ignored(self, names: Sequence[str]) -> None:
        """Log the names of parameters that have no effect, each once."""
        new = frozenset(names) - self._logged
        if new:
            self._logged |= new
            self.get_logger().info(f"parameters without an effect: {', '.join(sorted(new))}")

    def log_error(self, error: BaseException, what: str) -> None:
        """Log an error: one line per fault of an `OptdockError`, the traceback of any other exception."""
        known = isinstance(error, OptdockError)
        for line in str(error).splitlines() if known else ["".join(traceback.format_exception(error))]:
            self.get_logger().error(f"{what}: {line}")

    # Callbacks of rclpy.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Validate all parameters and set up."""
        try:
            _check_files(self)
            block = parameters_of(self)
            self.settings = self.check(block)
            self._has_begun = True
            self.set_up()
            self._bond = self._bond or _bond_of(self, block)
            self._is_configured = True
        except Exception as error:  # by a subclass, a plugin or rclpy
            self.log_error(error, "configure failed")
            self.end()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        self.is_active = True
        try:
            self.start()
        except Exception as error:
            self.log_error(error, "activate failed")
            self.halt()
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info("active")
        if self._bond is not None:
            self._bond.start()
        if self.owns_process:
            # Later garbage collections, which stop all threads, skip everything that is loaded by now.
            gc.unfreeze()
            gc.collect()
            gc.freeze()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End all work."""
        self.halt()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Tear down."""
        self.end()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End all work at once, and tear down after clients have fetched the results of their goals."""
        self.halt()

        def _end() -> None:
            self.destroy_timer(timer)
            self.end()

        timer = self.create_timer(_ANSWERS, _end, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Tear down after a transition has raised."""
        self.end()
        return super().on_error(state)

    def halt(self) -> None:
        """End all work, in any state."""
        if not self.is_active:
            return
        self.is_active = False
        try:
            self.stop()
        except Exception as error:
            self.log_error(error, "stop failed")
        if self._bond is not None:
            self._bond.end()

    def end(self) -> None:
        """End all work and tear down, in any state."""
        self.halt()
        if not self._has_begun:
            return
        self._has_begun = self._is_configured = False
        try:
            self.tear_down()
        except Exception as error:
            self.log_error(error, "cleanup failed")

    def _validate_change(self, changes: list[Parameter[Any]]) -> SetParametersResult:
        if not self._is_configured:  # configure validates all parameters
            return SetParametersResult(successful=True)
        try:
            block = parameters_of(self, changes)
            for parameter in changes:
                _require_changeable(self, parameter)
            self.check(block)
        except Exception as error:
            if not isinstance(error, OptdockError):
                self.log_error(error, "a change of parameters failed")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_change(self, _changes: list[Parameter[Any]]) -> None:
        if not self._is_configured:
            return
        try:
            self.settings = self.check(parameters_of(self))
            self.changed()
        except Exception as error:
            self.log_error(error, "a change of parameters failed")


def _check_files(server: Server[Any]) -> None:
    """Raise `InvalidValue` if the files have parameters of a server in another namespace only; log if none."""
    shared = names_of(Block.ANY_NODE) | ServerParameters.model_fields.keys()
    known = server.Parameters.model_fields.keys() - shared
    why, is_elsewhere = missing_parameters(server.files, server.get_fully_qualified_name(), known, shared)
    if is_elsewhere:
        raise InvalidValue(f"{why}; the namespaces must be the same, or use /**/{server.get_name()}")
    if why:
        server.get_logger().warning(f"{why}; all parameters have their defaults")


def _require_changeable(server: Server[Any], parameter: Parameter[Any]) -> None:
    """Raise `InvalidValue` for a new value of a parameter that is read at configure only."""
    fixed = server.fixed | ServerParameters.model_fields.keys()
    is_fixed = any(parameter.name == name or parameter.name.startswith(f"{name}.") for name in fixed)
    if not is_fixed and not parameter.name.endswith(".plugin"):
        return
    if parameter.value != server.get_parameter_or(parameter.name).value:
        raise InvalidValue(f"{parameter.name}: cannot be changed while configured; clean up first")


def _bond_of(node: Server[Any], block: dict[str, object]) -> Bond | None:
    """Return the bond to a lifecycle manager, or None if it is switched off or its messages are not installed."""
    own = {name: block[name] for name in ServerParameters.model_fields if name in block}
    period = parse_parameters(ServerParameters, own, node.get_name()).bond_heartbeat_period
    if period == 0.0:
        return None
    try:
        return Bond(node, period)
    except ImportError:
        node.get_logger().info("no package bond: set bond_timeout: 0.0 at the lifecycle manager")
    return None


class _Leave(Exception):
    """Request that the thread of the executor ends."""


def leave() -> None:
    """Task that ends an executor's `spin`."""
    raise _Leave


def spin(executor: Executor) -> None:
    """Run an executor until its task is `leave`; exceptions of callbacks are logged.

    The executor must not be shut down earlier: an executor of rclpy that is shut down between two waits begins another
    wait, which never ends.
    """
    while not _has_left(executor):
        pass


def _has_left(executor: Executor) -> bool:
    """Run callbacks until one raises, and return whether that was `leave`."""
    try:
        executor.spin()
    except (_Leave, ExternalShutdownException):
        return True
    except Exception:
        get_logger("optdock_ros").error(f"in a callback: {traceback.format_exc()}")
    return False


def _end_at_signals(ended: threading.Event) -> None:
    """Set `ended` on SIGINT and SIGTERM; a further signal after `_PATIENCE` kills the process."""
    first = math.inf

    def _end(number: int, _frame: object) -> None:
        nonlocal first
        now = time.monotonic()
        first = min(first, now)
        if now - first > _PATIENCE:  # a second ctrl-C must not interrupt the ramp of a moving robot
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)


def run(make: Callable[[], Server[Any]], args: Sequence[str] | None = None) -> int:
    """Run the process of a server until SIGINT or SIGTERM.

    At the end the robot is stopped and goals are answered, then the executor's thread is joined, and then the context
    is shut down.

    Args:
        make: Makes the server.
        args: Command line; None for that of the process.

    Returns:
        The exit code: 0 after a signal.
    """
    ended = threading.Event()
    # Not the handlers of rclpy, which shut the context down before the stop command is sent.
    rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
    _end_at_signals(ended)
    sys.setswitchinterval(_SWITCH)
    try:
        server = make()
    except Exception:
        get_logger("optdock_ros").fatal(traceback.format_exc())
        rclpy.try_shutdown()
        return 1
    server.owns_process = True
    server.files = blocks_of(sys.argv if args is None else args)
    executor = SingleThreadedExecutor()
    executor.add_node(server)
    thread = threading.Thread(target=spin, args=(executor,), name="executor", daemon=True)
    thread.start()
    if any(server.get_parameter(name).value is True for name in ("autostart", "autostart_node")):
        executor.create_task(_autostart, server)
    while not ended.wait(1.0) and thread.is_alive():
        pass
    failed = not ended.is_set()
    _in_executor(executor, thread, server.halt)
    time.sleep(_ANSWERS)
    _in_executor(executor, thread, server.end)
    executor.create_task(leave)
    thread.join(_PATIENCE)
    executor.shutdown()
    gc.unfreeze()  # frozen objects are not destroyed at exit, and other nodes would see this node for 20 s
    server.destroy_node()
    rclpy.try_shutdown()
    return int(failed)


def _autostart(server: Server[Any]) -> None:
    if server.trigger_configure() == TransitionCallbackReturn.SUCCESS:
        server.trigger_activate()


def _in_executor(executor: Executor, thread: threading.Thread, work: Callable[[], None]) -> None:
    """Call `work` once: between callbacks, or in this thread if the executor's thread hangs or has ended."""
    done, begun = threading.Event(), threading.Lock()

    def _once() -> None:
        if begun.acquire(blocking=False):
            try:
                work()
            finally:
                done.set()

    if thread.is_alive():
        executor.create_task(_once)
        done.wait(_PATIENCE)
    _once()
