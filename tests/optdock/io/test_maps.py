import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from optdock.errors import InvalidFile
from optdock.io.map_image import GreyImage
from optdock.io.maps import MapInfo, MapMode, load_map, occupancy_from_image
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.costs import OccupancyRule

KEYS = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[-1.0, 2.0, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}
GREYS = np.arange(256, dtype=np.uint8)[None]


@pytest.fixture
def map_file(tmp_path):
    def write(grey=((0, 255), (205, 254)), **changes):
        values = np.array(grey, dtype=np.uint8)
        (tmp_path / "map.pgm").write_bytes(f"P5 {values.shape[1]} {values.shape[0]} 255\n".encode() + values.tobytes())
        keys = {**KEYS, **changes}
        path = tmp_path / "map.yaml"
        path.write_text("".join(f"{key}: {value}\n" for key, value in keys.items() if value is not None))
        return path

    return write


def faults_of(path):
    with pytest.raises(InvalidFile) as error:
        load_map(path)
    return str(error.value).splitlines()


def test_the_last_image_row_is_the_lowest(map_file):
    grid = load_map(map_file())
    assert grid.data.tolist() == [[-1, 0], [100, 0]]
    assert (grid.resolution, grid.origin) == (0.05, (-1.0, 2.0))
    assert grid.costmap.cost_at([[-0.975, 2.075]]).tolist() == [254]


def info(**changes):
    values = {"negate": False, "occupied_thresh": 0.65, "free_thresh": 0.196, "mode": MapMode.TRINARY, **changes}
    return MapInfo(image="m.pgm", resolution=0.05, origin=[0.0, 0.0, 0.0], **values)


def slow_occupancy(v, negate, occupied, free, mode):
    """Map by map_server's words, one pixel at a time."""
    if mode is MapMode.RAW:
        return v if v <= 100 else -1
    p = v / 255 if negate else (255 - v) / 255
    if p >= occupied:
        return 100
    if p <= free:
        return 0
    return -1 if mode is MapMode.TRINARY else round(100 * (p - free) / (occupied - free))


@settings(max_examples=25)
@given(st.booleans(), st.floats(0, 1), st.floats(0, 1), st.sampled_from(MapMode))
def test_every_grey_value_follows_map_server(negate, a, b, mode):
    free, occupied = sorted((a, b))
    found = occupancy_from_image(
        GreyImage(GREYS), info(negate=negate, occupied_thresh=occupied, free_thresh=free, mode=mode)
    )
    expected = [slow_occupancy(v, negate, occupied, free, mode) for v in range(256)]
    # A half may round either way.
    difference = np.abs(found[0].astype(int) - expected)
    assert difference.max() <= (1 if mode is MapMode.SCALE else 0)


def test_the_thresholds_belong_to_occupied_and_free():
    found = occupancy_from_image(GreyImage(GREYS), info(occupied_thresh=155 / 255, free_thresh=55 / 255))[0]
    assert [found[v] for v in (100, 101, 199, 200)] == [100, -1, -1, 0]


def test_scale_spans_the_gap():
    found = occupancy_from_image(GreyImage(GREYS), info(occupied_thresh=1.0, free_thresh=0.0, mode=MapMode.SCALE))[0]
    assert [found[v] for v in (0, 255, 51, 204)] == [100, 0, 80, 20]


def test_negating_swaps_black_and_white():
    plain = occupancy_from_image(GreyImage(GREYS), info())
    negated = occupancy_from_image(GreyImage(GREYS[:, ::-1]), info(negate=True))
    np.testing.assert_array_equal(plain, negated)


@pytest.mark.parametrize(("mode", "expected"), [(MapMode.TRINARY, -1), (MapMode.SCALE, -1), (MapMode.RAW, 0)])
def test_transparent_pixels_are_unknown_except_in_raw(mode, expected):
    image = GreyImage(np.zeros((1, 2), dtype=np.uint8), np.array([[False, True]]))
    assert occupancy_from_image(image, info(mode=mode))[0, 1] == expected


def test_the_savers_unknown_depends_on_the_free_threshold(map_file, caplog):
    with caplog.at_level(logging.WARNING):
        assert load_map(map_file([[205]])).data.tolist() == [[-1]]
        assert not caplog.records
        assert load_map(map_file([[205, 205, 255]], free_thresh="0.25")).data.tolist() == [[0, 0, 0]]
    assert "2 pixels of grey 205 free" in caplog.text


@pytest.mark.parametrize("mode", ["raw", "RAW", "Raw"])
def test_the_mode_may_be_in_any_case(map_file, mode):
    assert load_map(map_file([[0, 57, 100, 101, 255]], mode=mode)).data.tolist() == [[0, 57, 100, -1, -1]]


@pytest.mark.parametrize("negate", ["1", "true"])
def test_negate_is_a_number_or_a_boolean(map_file, negate):
    assert load_map(map_file([[0, 255]], negate=negate)).data.tolist() == [[0, 100]]


def test_an_absolute_image_path_and_unknown_keys_are_fine(map_file, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    path = map_file(image=str(tmp_path / "map.pgm"), cartographer_note="x")
    moved = path.rename(tmp_path / "elsewhere" / "map.yaml")
    assert load_map(moved).data.shape == (2, 2)


def test_a_colour_png_with_alpha(map_file, tmp_path):
    rgba = np.array([[[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 0]]], dtype=np.uint8)
    Image.fromarray(rgba).save(tmp_path / "map.png")
    assert load_map(map_file(image="map.png")).data.tolist() == [[100, 0, -1]]


@pytest.mark.parametrize(
    ("changes", "line", "message"),
    [
        ({"resolution": "0"}, 2, "resolution: must be finite and > 0 m, got 0"),
        ({"resolution": ".nan"}, 2, "resolution: must be finite and > 0 m, got nan"),
        ({"resolution": "fine"}, 2, "resolution: must be finite and > 0 m, got 'fine'"),
        ({"resolution": "true"}, 2, "resolution: must be finite"),
        ({"resolution": "1" + "0" * 400}, 2, "resolution: must be finite"),
        ({"resolution": None}, 1, "resolution: is required"),
        ({"origin": "[0, 0]"}, 3, "origin: must be [x, y, yaw]"),
        ({"origin": "[0, 0, .inf]"}, 3, "origin: must be [x, y, yaw]"),
        ({"origin": "0"}, 3, "origin: must be [x, y, yaw], three finite numbers, got 0"),
        ({"origin": "[0, 0, 0.1]"}, 3, "origin: yaw must be 0, got 0.1: "),
        ({"negate": "2"}, 4, "negate: must be 0 or 1, got 2"),
        ({"negate": None}, 1, "negate: is required"),
        ({"occupied_thresh": "1.1"}, 5, "occupied_thresh: must be a probability in 0..1, got 1.1"),
        ({"free_thresh": "-0.1"}, 6, "free_thresh: must be a probability in 0..1, got -0.1"),
        ({"free_thresh": "0.7"}, 6, "free_thresh: must be <= occupied_thresh = 0.65, got 0.7"),
        ({"mode": "binary"}, 7, "mode: must be one of trinary, scale, raw, got 'binary'"),
        ({"image": "7"}, 1, "image: must be the name of an image file, got 7"),
        ({"image": None}, 1, "image: is required"),
        ({"image": "none.pgm"}, 1, "none.pgm: cannot be read: No such file"),
    ],
)
def test_every_fault_names_line_key_value_and_rule(map_file, changes, line, message):
    (fault,) = faults_of(map_file(**changes))
    assert f"map.yaml:{line}: " in fault
    assert message in fault


def test_all_faults_come_at_once_those_of_the_image_too(map_file):
    faults = faults_of(map_file(image="none.pgm", resolution="-1", origin=None, negate="no way", mode="x"))
    assert [fault.split(": ")[1] for fault in faults] == ["origin", "image", "resolution", "negate", "mode"]


def test_a_file_that_is_no_mapping_is_refused(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text("- 1\n- 2\n")
    assert "must be a mapping of map_server keys, got a list" in faults_of(path)[0]


def test_raw_needs_eight_bit(map_file, tmp_path):
    path = map_file(mode="raw")
    (tmp_path / "map.pgm").write_bytes(b"P5 1 1 65535\n\0\1")
    assert "mode: raw needs an image of 8 bit" in faults_of(path)[0]


def test_a_map_without_end_is_refused(map_file):
    assert "upper corner must be finite" in faults_of(map_file(resolution="1.0e+308"))[0]


# Counts of a separate reading: Pillow's pixels against the three thresholds, once, by hand.
REAL_MAPS = {
    "depot": ((307, 604), 179481, 5947, 0),
    "tb3_sandbox": ((384, 384), 7903, 870, 138683),
    "warehouse": ((1674, 1006), 1422292, 30951, 230801),
}


@pytest.mark.parametrize("name", REAL_MAPS)
def test_real_maps(real_data, name):
    grid = load_map(real_data / "nav2" / "maps" / f"{name}.yaml")
    shape, *counts = REAL_MAPS[name]
    assert grid.data.shape == shape
    assert [int(np.count_nonzero(grid.data == value)) for value in (0, 100, -1)] == counts
    pixels = np.asarray(Image.open(real_data / "nav2" / "maps" / f"{name}.pgm").convert("L"))
    np.testing.assert_array_equal(grid.data == 100, ((255 - pixels) / 255 >= 0.65)[::-1])


@pytest.mark.parametrize("name", REAL_MAPS)
def test_obstacles_of_real_maps_cover_their_cells(real_data, name):
    grid = load_map(real_data / "nav2" / "maps" / f"{name}.yaml")
    costmap = grid.costmap_by(OccupancyRule())
    obstacles = obstacles_from_costmap(costmap, border=False)
    area = np.sum(np.prod(obstacles.upper - obstacles.lower, axis=1))
    assert area == pytest.approx(np.count_nonzero(costmap.data >= 254) * grid.resolution**2, rel=1e-9)


def test_a_picture_in_the_place_of_its_yaml_file_is_refused_with_that_file(map_file, tmp_path):
    described = map_file()
    picture = tmp_path / "map.pgm"
    assert faults_of(picture) == [f"{picture}: is an image; give the YAML file next to it, map.yaml"]
    described.rename(tmp_path / "hall.yaml")
    assert faults_of(picture) == [f"{picture}: is an image; give the YAML file that describes it, such as map.yaml"]
    assert "cannot be read: No such file" in faults_of(tmp_path / "none.pgm")[0]
