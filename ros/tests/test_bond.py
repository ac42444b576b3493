"""The bond with a stand-in of the lifecycle manager's side, by the rules of `bondcpp`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from bond.msg import Status
from optdock_ros import bond
from rclpy.lifecycle import LifecycleNode

if TYPE_CHECKING:
    from collections.abc import Callable

    from harness import Client, Lifecycle, Processes

PERIOD = 0.1  # [s], the servers' default


class Manager:
    """The manager's side, which receives the heartbeat of another instance with the same id."""

    def __init__(self, client: Client, name: str) -> None:
        self.name, self.heard = name, list[tuple[float, Status]]()
        self._publisher = client.create_publisher(Status, "bond", 10)
        client.create_subscription(Status, "bond", self._take, 10)
        client.create_timer(PERIOD, self._beat)

    def _beat(self) -> None:
        self._publisher.publish(
            Status(id=self.name, instance_id="manager", active=True, heartbeat_timeout=4.0, heartbeat_period=PERIOD)
        )

    def _take(self, status: Status) -> None:
        if status.id == self.name and status.instance_id != "manager":
            self.heard.append((time.monotonic(), status))

    @property
    def sister(self) -> str:
        """Id of the last instance; empty after it has ended the bond."""
        return self.heard[-1][1].instance_id if self.heard and self.heard[-1][1].active else ""


def test_a_bond_forms_lives_and_ends_with_the_server(
    process: Processes, client_node: Client, lifecycle: Callable[[str], Lifecycle]
) -> None:
    server = "smoother_server"
    started, life, manager = process(server), lifecycle(server), Manager(client_node, server)
    assert life.configure()
    time.sleep(3.0 * PERIOD)
    assert manager.heard == [], "a bond is formed by activate"
    assert life.activate()
    client_node.until(lambda: len(manager.heard) > 10, what="ten heartbeats")
    first = manager.sister
    assert first
    assert manager.heard[-1][1].heartbeat_period == pytest.approx(PERIOD)
    gaps = [b - a for (a, _), (b, _) in zip(manager.heard, manager.heard[1:], strict=False)]
    assert max(gaps) < manager.heard[-1][1].heartbeat_timeout
    assert life.deactivate()
    client_node.until(lambda: manager.sister == "", 2.0, "the end of the bond")
    assert life.activate()
    client_node.until(lambda: manager.sister not in {"", first}, 2.0, "a bond of another instance")
    assert started.stop() == 0
    assert manager.sister == "", "who ends says so: else the manager would wait for the timeout"


def test_heartbeat_continues_during_a_long_callback_and_pauses_if_it_hangs(
    client_node: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    manager, node = Manager(client_node, "hanging"), LifecycleNode("hanging")
    made = bond.Bond(node, 0.02)
    monkeypatch.setattr(bond, "TIMEOUT", 0.0)
    made.start()  # no executor runs this node
    client_node.until(lambda: len(manager.heard) > 20, what="a heartbeat without the executor")
    monkeypatch.setattr(bond, "HANGING", 0.0)
    time.sleep(0.2)
    count = len(manager.heard)
    time.sleep(0.2)
    assert len(manager.heard) == count
    made.end()
    node.destroy_node()


def test_no_bond_with_period_zero(
    process: Processes, client_node: Client, lifecycle: Callable[[str], Lifecycle]
) -> None:
    process("smoother_server", params={"bond_heartbeat_period": 0.0})
    manager = Manager(client_node, "smoother_server")
    lifecycle("smoother_server").up()
    time.sleep(5.0 * PERIOD)
    assert manager.heard == []
