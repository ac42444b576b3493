import math

import numpy as np
import pytest
from typer.testing import CliRunner

from optdock.cli import app
from optdock.errors import InvalidFile
from optdock.geometry.pose import Pose2
from optdock.model.costmap import OccupancyGrid
from optdock.model.dock import Dock
from optdock.nav2.global_costmap import file_costmap
from optdock.nav2.params import load_nav2_params

SIDE, NAME = 0.05, "global_costmap"
START, DOCK = Pose2(0.5, 1.5, 0.0), Dock(Pose2(2.5, 1.5, 0.0))
STATIC = 'static_layer: {plugin: "nav2_costmap_2d::StaticLayer", map_topic: map}'
INFLATION = 'inflation: {plugin: "nav2_costmap_2d::InflationLayer", inflation_radius: 0.7, cost_scaling_factor: 3.0}'


def params(folder, *layers, node="", local=False):
    names = ", ".join(layer.split(":")[0] for layer in layers)
    blocks = "".join(f"      {layer}\n" for layer in layers)
    text = (
        "global_costmap:\n  global_costmap:\n    ros__parameters:\n"
        "      robot_radius: 0.22\n      footprint_padding: 0.0\n"
        f"      plugins: [{names}]\n{node}{blocks}"
    )
    if local:
        text += "local_costmap:\n  local_costmap:\n    ros__parameters: {plugins: [], rolling_window: true}\n"
    (folder / "params.yaml").write_text(text)
    return load_nav2_params(folder / "params.yaml")


def hall():
    """Free, with one occupied cell in the middle, and unknown from x = 1.7 m on in the upper half."""
    occupancy = np.zeros((60, 60), dtype=np.int8)
    occupancy[30:, 34:] = -1
    occupancy[30, 30] = 100
    return OccupancyGrid(occupancy, SIDE)


def built(read, grid=None, described=NAME):
    costmap, rows = file_costmap(read, read.costmaps[described], grid or hall(), START, DOCK)
    return costmap, dict(rows)


@pytest.mark.parametrize(
    ("node", "cost", "said"),
    [
        ("      track_unknown_space: true\n", 255, "obstacles"),
        ("      track_unknown_space: false\n", 0, "free: track_unknown_space is false"),
        ("", 255, "obstacles (track_unknown_space is not given; Nav2 would treat them as free)"),
    ],
)
def test_unknown_cells_follow_the_file_and_are_obstacles_by_default(tmp_path, node, cost, said):
    costmap, rows = built(params(tmp_path, STATIC, node=node))
    assert set(costmap.data[30:, 34:].ravel().tolist()) == {cost}
    assert rows["unknown cells"] == said


FALSE, TRUE = "track_unknown_space: false", "track_unknown_space: true"


@pytest.mark.parametrize(
    ("node", "static", "cost", "said"),
    [
        (TRUE, STATIC[:-1] + f", {FALSE}}}", 0, "free: track_unknown_space is false"),
        ("", STATIC[:-1] + f", {FALSE}}}", 0, "free: track_unknown_space is false"),
        (FALSE, STATIC[:-1] + f", {TRUE}}}", 255, "obstacles: track_unknown_space is false, but not for the layer"),
        (FALSE, INFLATION, 255, "obstacles: track_unknown_space is false, but not for the layer of the map"),
    ],
)
def test_the_report_on_unknown_cells_follows_the_layer_of_the_map(tmp_path, node, static, cost, said):
    costmap, rows = built(params(tmp_path, static, node=f"      {node}\n"))
    assert set(costmap.data[34:, 36:].ravel().tolist()) == {cost}
    assert rows["unknown cells"].startswith(said)


@pytest.mark.parametrize(
    ("layers", "frees"),
    [
        ([STATIC], False),
        ([STATIC[:-1] + ", footprint_clearing_enabled: true}"], True),
        ([STATIC, "seen: {plugin: ObstacleLayer, combination_method: 0}"], False),
    ],
)
def test_a_layer_that_clears_the_cells_under_the_robot_is_reported(tmp_path, layers, frees):
    blocked = OccupancyGrid(np.full((60, 60), 100, dtype=np.int8), SIDE)
    costmap, rows = built(params(tmp_path, *layers), blocked)
    assert bool(np.any(costmap.data != 254)) is frees
    assert any("clears the cells under the robot" in row for row in rows.values()) is frees


def test_the_map_is_added_if_the_file_has_no_static_layer(tmp_path):
    added = "added: the file uses none, but a map was given"
    for layers in ([INFLATION], [STATIC[:-1] + ", enabled: false}", INFLATION]):
        costmap, rows = file_costmap(read := params(tmp_path, *layers), read.costmaps[NAME], hall(), START, DOCK)
        assert costmap.data[30, 30] == 254
        assert ("static_layer", added) in rows
    assert ("static_layer", "skipped: enabled is false") in rows


def test_skipped_parts_are_reported_with_their_reason(tmp_path):
    second = STATIC.replace("static_layer", "other_map")
    voxels = 'voxels: {plugin: "nav2_costmap_2d::VoxelLayer"}'
    seen = 'seen: {plugin: "nav2_costmap_2d::ObstacleLayer", observation_sources: scan, scan: {topic: /scan}}'
    clouds = 'clouds: {plugin: "stvl::SpatioTemporalVoxelLayer"}'
    keepout = '      filters: [keepout]\n      keepout: {plugin: "nav2_costmap_2d::KeepoutFilter"}\n'
    rolling = "      rolling_window: true\n"
    _, rows = built(
        params(tmp_path, STATIC, second, voxels, seen, INFLATION, clouds, node=keepout + rolling, local=True)
    )
    assert rows[NAME].endswith("; it does not roll, because the whole map is known")
    assert rows["other_map"] == "skipped: there is no second map"
    assert rows["voxels"] == rows["seen"] == "skipped: there is no sensor data yet"
    assert (
        rows["inflation"]
        == "skipped: the clearance is proven with the exact footprint, so inflated costs change no plan"
    )
    assert rows["static_layer"] == "used: StaticLayer(); not read: map_topic"
    assert rows["clouds"] == "skipped: optdock has no layer of this class"
    assert rows["keepout"] == "skipped: optdock has no filters; the restrictions of this filter are not in the costmap"
    assert rows["local_costmap"].startswith("skipped: it contains only sensor data")


def test_a_layer_that_refuses_its_parameters_is_a_fault_of_the_file(tmp_path):
    wrong = 'dock: {plugin: "optdock::DockLayer", contact_margin: -1.0}'
    with pytest.raises(InvalidFile, match=r"params\.yaml:\d+: dock: .*contact_margin"):
        built(params(tmp_path, STATIC, wrong))


def test_a_dock_layer_frees_the_docked_robot(tmp_path):
    blocked = OccupancyGrid(np.full((60, 60), 100, dtype=np.int8), SIDE)
    layer = 'dock: {plugin: "optdock::DockLayer", contact_margin: 0.0}'
    costmap, _ = built(params(tmp_path, STATIC, layer), blocked)
    free = costmap.centre_of(np.argwhere(costmap.data == 0)[:, ::-1])
    distance = np.hypot(*(free - [DOCK.pose.x, DOCK.pose.y]).T)
    assert distance.max() <= 0.23 + SIDE
    assert math.pi * 0.22**2 / SIDE**2 < len(free)


def test_a_file_without_nodes_is_one_costmap(tmp_path):
    (tmp_path / "grid.yaml").write_text(f"robot_radius: 0.22\nplugins: [inflation]\n{INFLATION}\n")
    costmap, rows = built(load_nav2_params(tmp_path / "grid.yaml"), described="grid")
    assert costmap.data[30, 30] == 254
    assert "inflation" in rows


def test_the_command_reports_the_layers_before_it_plans(tmp_path):
    params(tmp_path, STATIC, INFLATION, local=True)
    (tmp_path / "docks.yaml").write_text("docks: {home: {type: any, pose: [2.5, 1.0, 0.0]}}\n")
    (tmp_path / "hall.pgm").write_bytes(b"P5\n60 40\n255\n" + bytes([254]) * 2400)
    (tmp_path / "hall.yaml").write_text(
        "image: hall.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    files = {"nav2-params": "params.yaml", "map": "hall.yaml", "docks": "docks.yaml", "out": "plan.json"}
    options = [part for name, file in files.items() for part in (f"--{name}", str(tmp_path / file))]
    result = CliRunner().invoke(app, ["plan", *options, "--start", "0.8,1.0,0.0", "--time-budget", "20"])
    assert result.exit_code == 0, result.output
    lines = [line.split("  ")[0] for line in result.output.splitlines()]
    assert lines[:5] == ["global_costmap", "unknown cells", "static_layer", "inflation", "local_costmap"]
    assert "status" in lines
