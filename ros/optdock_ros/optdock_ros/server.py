"""What all servers share: life cycle, parameters, one goal at a time, and the way a process ends.

A server's parameters are judged as a whole, into one frozen value (`Server.settings`), before anything is made of
them: at configure, where all faults are told at once, and at every change afterwards, which holds wholly or not at all.
Work that is under way goes on with the value before.

Callbacks are short: goals are worked on in threads of their own, and the executor's thread only takes messages and
answers. An error in a callback is told and does not end the node.
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
from optdock.plugins.parameters import parse_parameters
from optdock_ros.bond import Bond
from optdock_ros.nested_parameters import (
    ServerParameters,
    declare,
    declare_overrides,
    merged,
    parameters_of,
    unknown_names,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.context import Context
    from rclpy.executors import Executor
    from rclpy.parameter import Parameter

__all__ = ["Server", "run"]

S = TypeVar("S")

# [s], instead of Python's 5 ms: a thread that calculates gives way to the one that answers, or commands, within this.
_SWITCH = 0.0005
# [s] between the end of the work and that of the node: clients ask for the results of goals that ended just now.
_ANSWERS = 0.1

_PATIENCE = 10.0  # [s] for the last transitions of a process that was asked to end; a lifecycle manager waits as long


class Server(LifecycleNode, Generic[S]):
    """A lifecycle node with the parameters of a Nav2 server.

    A subclass says what its parameters mean (`check`), what it makes of them (`set_up`, `tear_down`) and how it begins
    and ends its work (`start`, `stop`). Each may raise: the transition fails, what was made is torn down, and the log
    says why.

    Args:
        name: Name of the node.
        namespace: Of the node, where the command line gives none.
        parameter_overrides: Values beside those of the command line, for tests and composition.
        context: rclpy's; None for the default one.

    Attributes:
        settings: What `check` made of the parameters; there from configure to cleanup.
        is_active: Whether it works.
        owns_process: Whether it is alone in this process; `run` sets it.
    """

    Parameters: ClassVar[type[ServerParameters]] = ServerParameters
    accepted: ClassVar[frozenset[str]] = frozenset()
    """Names of Nav2's that mean nothing here; they are listed in the log, and no fault."""
    fixed: ClassVar[frozenset[str]] = frozenset()
    """Names, and names of blocks, that are read at configure only and cannot be changed afterwards."""

    settings: S

    def __init__(
        self,
        name: str,
        *,
        namespace: str | None = None,
        parameter_overrides: Sequence[Parameter[Any]] | None = None,
        context: Context | None = None,
    ) -> None:
        given = list(parameter_overrides or ())
        # Undeclared ones may be set: a plugin that is named later brings parameters of its own.
        super().__init__(
            name,
            namespace=namespace,
            parameter_overrides=given,
            context=context,
            allow_undeclared_parameters=True,
        )
        declare_overrides(self, given)
        declare(self, self.Parameters)
        self.owns_process = False
        self._has_begun = False  # there is something to tear down
        self._is_configured = False
        self.is_active = False
        self._told: frozenset[str] = frozenset()
        self._bond: Bond | None = None
        self.add_on_set_parameters_callback(self._may_set)
        self.add_post_set_parameters_callback(self._have_set)

    # What a subclass says.

    def check(self, block: dict[str, object]) -> S:
        """Everything that the parameters mean, as one frozen value; nothing is made, subscribed or changed.

        Args:
            block: All parameters of the node, nested.

        Raises:
            OptdockError: What is wrong, one line per fault.
        """
        raise NotImplementedError

    def set_up(self) -> None:
        """Make what `settings` say: subscriptions, publishers, action servers."""

    def start(self) -> None:
        """Begin to work."""

    def stop(self) -> None:
        """End all work, and let nothing stand; also called where `start` failed half way."""

    def tear_down(self) -> None:
        """Give back what `set_up` made, also where it failed half way."""

    def changed(self, before: S) -> None:
        """Parameters were changed: `settings` are new."""

    # What all have in common.

    def own_parameters(self, block: dict[str, object], blocks: Sequence[str] = ()) -> ServerParameters:
        """The parameters of `Parameters`, checked; names at the top that are not read are listed or refused.

        Args:
            block: All parameters of the node, nested.
            blocks: Names at the top that are read elsewhere.

        Raises:
            InvalidValue: Values that break a rule, and names that look like misspelt ones; one line per fault.
        """
        fields = {spec.alias or name for name, spec in self.Parameters.model_fields.items()}
        faults, ignored = unknown_names(block, {*fields, *blocks}, self.accepted)
        own = {name: value for name, value in block.items() if name in fields}
        try:
            parsed = parse_parameters(self.Parameters, own, self.get_name())
        except InvalidValue as error:
            raise InvalidValue("\n".join([str(error), *faults])) from error
        if faults:
            raise InvalidValue("\n".join(faults))
        fresh = frozenset(ignored) - self._told
        if fresh:
            self._told |= fresh
            self.get_logger().info(f"parameters that mean nothing here: {', '.join(sorted(fresh))}")
        return parsed

    def say(self, error: BaseException, what: str) -> None:
        """One line of the log per fault; of an error that is not ours, where it came from as well."""
        if isinstance(error, OptdockError):
            for line in str(error).splitlines():
                self.get_logger().error(f"{what}: {line}")
        else:
            self.get_logger().error(f"{what}: {''.join(traceback.format_exception(error))}")

    # rclpy's side.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check all parameters, and make what they say."""
        try:
            block = parameters_of(self)
            self.settings = self.check(block)
            self._has_begun = True
            self.set_up()
            self._bond = self._bond or _bond_of(self, block)
            self._is_configured = True
        except Exception as error:  # a subclass, a plugin or rclpy: none may end the node
            self.say(error, "configure failed")
            self.end()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        try:
            self.start()
        except Exception as error:
            self.say(error, "activate failed")
            self._stopped()
            return TransitionCallbackReturn.FAILURE
        self.is_active = True
        self.get_logger().info("active")
        if self._bond is not None:
            self._bond.start()
        if self.owns_process:
            # What is loaded by now stays; later collections, which stop all threads, need not look at it.
            gc.unfreeze()  # of what an earlier activation left, some is garbage by now
            gc.collect()
            gc.freeze()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End all work."""
        self._stopped()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything back."""
        self.end()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End all work at once, and give everything back once clients have had the results of their goals."""
        self.halt()

        def _end() -> None:
            self.destroy_timer(timer)
            self.end()

        timer = self.create_timer(_ANSWERS, _end, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A transition raised, which these do not: nothing may stand."""
        self.end()
        return super().on_error(state)

    def halt(self) -> None:
        """End all work, in whatever state; nothing to do where none is done."""
        if self.is_active:
            self._stopped()

    def end(self) -> None:
        """End all work and give everything back, in whatever state; nothing to do where it has been done."""
        self.halt()
        if not self._has_begun:
            return
        self._has_begun = self._is_configured = False
        try:
            self.tear_down()
        except Exception as error:
            self.say(error, "cleanup failed")

    def _stopped(self) -> None:
        self.is_active = False
        try:
            self.stop()
        except Exception as error:
            self.say(error, "stop failed")
        if self._bond is not None:
            self._bond.end()

    def _may_set(self, changes: list[Parameter[Any]]) -> SetParametersResult:
        """Judge a change of parameters; before a configure any may come, which judges them all."""
        if not self._is_configured:
            return SetParametersResult(successful=True)
        try:
            block = merged(parameters_of(self), changes)
            for parameter in changes:
                _require_changeable(self, parameter)
            self.check(block)
        except Exception as error:
            if not isinstance(error, OptdockError):
                self.say(error, "a change of parameters failed")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _have_set(self, _changes: list[Parameter[Any]]) -> None:
        if not self._is_configured:
            return
        try:
            before, self.settings = self.settings, self.check(parameters_of(self))
            self.changed(before)
        except Exception as error:
            self.say(error, "a change of parameters failed")


def _require_changeable(node: Server[Any], parameter: Parameter[Any]) -> None:
    """Refuse to change a parameter that is read at configure only.

    Raises:
        InvalidValue: It is one, and the value is another one.
    """
    fixed = node.fixed | ServerParameters.model_fields.keys()
    name = next((n for n in fixed if parameter.name == n or parameter.name.startswith(f"{n}.")), None)
    if name is None and not parameter.name.endswith(".plugin"):
        return
    if parameter.value != node.get_parameter_or(parameter.name).value:
        raise InvalidValue(f"{parameter.name}: cannot be changed while configured; clean up first")


def _bond_of(node: Server[Any], block: dict[str, object]) -> Bond | None:
    """What a lifecycle manager listens for, where its messages are installed."""
    own = {name: block[name] for name in ServerParameters.model_fields if name in block}
    period = parse_parameters(ServerParameters, own, node.get_name())
    if period.bond_heartbeat_period == 0.0:
        return None
    try:
        return Bond(node, period.bond_heartbeat_period)
    except ImportError:
        node.get_logger().info("no package bond: set bond_timeout: 0.0 at the lifecycle manager")
    return None


class _Left(Exception):
    """The executor's thread is to leave."""


def leave() -> None:
    """A task for an executor that runs by `spin`: its last one."""
    raise _Left


def spin(executor: Executor) -> None:
    """Run an executor until `leave` is its task; an error of a callback is logged, and the others go on.

    It is not to be shut down before: rclpy's executor that is shut down between two waits begins another one, in which
    nothing wakes it any more.
    """
    while not _has_left(executor):
        pass


def _has_left(executor: Executor) -> bool:
    """Callbacks until one raises; whether that was `leave`."""
    try:
        executor.spin()
    except (_Left, ExternalShutdownException):
        return True
    except Exception:
        get_logger("optdock_ros").error(f"in a callback: {traceback.format_exc()}")
        return False
    return True


def _end_at_signals(ended: threading.Event) -> None:
    """Have SIGINT and SIGTERM set `ended`; asked again when all should be over, they kill."""
    asked = math.inf

    def _end(number: int, _frame: object) -> None:
        nonlocal asked
        now = time.monotonic()
        asked = min(asked, now)
        if now - asked > _PATIENCE:  # by then the robot stands; an impatient second ctrl-C must not end its ramp
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)


def run(make: Callable[[], Server[Any]], args: Sequence[str] | None = None) -> int:
    """The life of a server's process: made, spun in a thread, and ended by SIGINT or SIGTERM in good order.

    The order of the end: work is ended, stop commands are out, goals are answered; then the executor's thread is
    joined, and only then the context goes down.

    Args:
        make: Makes the server.
        args: Of the command line; None: the process's.

    Returns:
        The exit code, 0 after a signal.
    """
    ended = threading.Event()

    # Handlers of our own: rclpy's take the context down at once, and the stop command with it.
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
    executor = SingleThreadedExecutor()
    executor.add_node(server)
    thread = threading.Thread(target=spin, args=(executor,), name="executor", daemon=True)
    thread.start()
    if server.get_parameter("autostart").value is True:
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
    gc.unfreeze()  # what is frozen is not given back at the end, and others would take this node for alive for 20 s
    server.destroy_node()
    rclpy.try_shutdown()
    return int(failed)


def _autostart(server: Server[Any]) -> None:
    if server.trigger_configure() == TransitionCallbackReturn.SUCCESS:
        server.trigger_activate()


def _in_executor(executor: Executor, thread: threading.Thread, work: Callable[[], None]) -> None:
    """Do something between callbacks; in this thread where the executor's does nothing any more."""
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
