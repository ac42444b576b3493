"""`optdock ui` in Chromium: input by pointer, finger, keyboard, widgets and address, and the page after it."""

import io
import math
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image

pytest.importorskip("bokeh")

from typer.testing import CliRunner

from optdock.cli import app
from optdock.reports.html.figures import PALETTE
from optdock.ui.scene_files import worked_scenes
from optdock.ui.scene_view import GHOSTS
from tests.browser.opened_page import ROOT, OpenedPage, Program, launched, missing
from tests.browser.page_picture import Picture, along, crowded, faint

if missing():
    pytest.skip(f"the test of the page {missing()}", allow_module_level=True)

PICTURES = ROOT / "results" / "ui"
SCENE = next(path for path in worked_scenes() if path.stem == "reverse_bay").read_text()
NEAR = 12  # of 255, difference of colours that count as equal
HOSTILE = "<script>window.taken = 1</script><img src=x onerror='window.taken = 1'>"
# Elements of hostile texts, also inside widgets.
INTRUDERS = """() => {
  const none = {children: []};
  const within = (node) =>
    [...node.children].flatMap((one) => [one, ...within(one), ...within(one.shadowRoot ?? none)]);
  return [window.taken ?? 0, within(document).filter((one) => one.matches("img[src=x]")).length];
}"""
# Parts whose text does not fit.
CUT = """() => ["#status", "h1", "header p", ".legend", "footer"].filter((name) => {
  const one = document.querySelector(name);
  return one.scrollHeight > one.clientHeight + 1 || one.scrollWidth > one.clientWidth + 1;
})"""
FOCUSED = """() => {
  let one = document.activeElement;
  while (one?.shadowRoot?.activeElement) one = one.shadowRoot.activeElement;
  return one?.tagName === "BUTTON" ? one.innerText.trim() : "";
}"""
SPEED = """() => {
  const chart = Bokeh.documents[0].get_model_by_name("curves").children[0], {data} = chart.renderers[0].data_source;
  return Object.fromEntries(Object.entries(data).map(([key, column]) => [key, Array.from(column)]));
}"""
# The robot of the player, with the view of its camera and its tube.
HIDE = f"""() => {{
  for (const name of {[*GHOSTS]}) Bokeh.documents[0].get_model_by_name(name).visible = false;
}}"""
CURSORS = """() => {
  const model = (name) => Bokeh.documents[0].get_model_by_name(name);
  const spans = model("curves").children.map((one) => one.center.find((part) => part.type === "Span").location);
  return [spans, model("player").value, model("player").end];
}"""


@pytest.fixture(scope="module")
def browser():
    with launched() as browser:
        yield browser


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    program = Program(tmp_path_factory.mktemp("folder"))
    yield program
    program.end()
    assert "Traceback" not in program.log.read_text(), program.log.read_text()


@pytest.fixture
def opened(browser, program):
    """A function that opens the page, each time in a context of its own."""
    contexts = []

    def opened(query="", url=program.url, **options):
        contexts.append(browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options}))
        return OpenedPage(contexts[-1], url + query)

    yield opened
    for context in contexts:
        context.close()


@pytest.fixture
def page(opened):
    page = opened()
    yield page
    assert page.errors == []


def near(place, other, within=2e-3):
    return math.dist(place, other) < within


def pictured(page, name):
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.page.screenshot(path=str(PICTURES / f"{name}.png"), full_page=True)


def ink_at(page, place, colour, reach):
    """Number of pixels with a colour in a square around a place of the figure, `reach` pixels to each side."""
    x, y = page.pixel(place)
    page.settle()
    picture = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
    part = picture.crop((int(x - reach), int(y - reach), int(x + reach), int(y + reach)))
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return sum(count for count, ink in part.getcolors(1 << 20) if max(map(dist, ink, wanted)) <= NEAR)


def free_place(page):
    """A place before the dock of the built-in scene without an obstacle or a path."""
    x, y = page.robot("dock")
    return [x - 1.0, y + 1.0]


def dist(one, other):
    return abs(one - other)


def middle(columns, row):
    """Mean of the corners of a polygon of a layer [m]."""
    return [sum(columns[axis][row]) / len(columns[axis][row]) for axis in ("xs", "ys")]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", ["desktop", "phone"])
def test_the_page_opens_without_errors_and_fits(opened, size, scheme):
    phone = size == "phone"
    width, height = (390, 844) if phone else (1280, 900)
    page = opened(viewport={"width": width, "height": height}, color_scheme=scheme, has_touch=phone, is_mobile=phone)
    assert page.outcome == "certified"
    assert page.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0
    variant = int(scheme == "dark")
    assert ink_at(page, page.robot(), PALETTE["start"][variant], 90) > 20
    assert ink_at(page, page.robot("dock"), PALETTE["goal"][variant], 90) > 20
    assert ink_at(page, free_place(page), PALETTE["paper"][variant], 10) > 100
    page.field("clearance [m]")  # opens all groups
    assert faint(page) == []
    assert crowded(page) == []
    assert page.page.evaluate(CUT) == []
    pictured(page, f"{size}-{scheme}")
    assert page.errors == []


def test_pictures_of_a_drag_belong_to_their_scenes(page):
    page.record()
    place = page.robot()
    page.press(place)
    x, y = page.pixel(place)
    for k in range(1, 61):
        page.page.mouse.move(x + 40 * math.sin(k / 10), y - 30 * math.sin(k / 5))
        page.page.wait_for_timeout(33)  # pace of the hand
    state = page.state
    end = [place[0] + 0.4, place[1] + 0.2]
    page.page.mouse.move(*page.pixel(end), steps=4)
    page.page.mouse.up()
    page.settle_after(state)
    assert near(page.robot(), end, 0.02)
    assert near(page.path_start(), page.robot())
    paints = page.recorded["paints"]
    starts = {}
    for paint in paints:
        assert near(starts.setdefault(paint["scene"], paint["robot"]), paint["robot"])
    shown = [paint for paint in paints if paint["shown"] in starts and paint["first"]]
    assert len({paint["shown"] for paint in shown}) > 5
    assert [paint for paint in shown if not near(starts[paint["shown"]], paint["first"])] == []


def test_a_drag_may_begin_slowly(page):
    place, state = page.robot(), page.state
    page.press(place)
    page.page.wait_for_timeout(600)
    end = [place[0] - 0.2, place[1] + 0.1]
    page.page.mouse.move(*page.pixel(end), steps=30)
    page.page.mouse.up()
    page.settle_after(state)
    assert near(page.robot(), end, 0.02)


def test_a_picture_of_a_greater_view_arrives_whole(page):
    """The rectangle of the figure and the layers change at once when the robot is released outside."""
    place = page.robot()
    state = page.state
    page.drag(place, [place[0] - 0.5, place[1] + 2.0])
    page.settle_after(state)
    assert near(page.robot(), [place[0] - 0.5, place[1] + 2.0], 0.02)
    assert page.path_start() is None or near(page.path_start(), page.robot())


def test_selected_parts_are_marked(page):
    dock = page.robot("dock")
    page.page.mouse.click(*page.pixel(dock))
    page.wait(
        "([x, y]) => { const grips = Bokeh.documents[0].get_model_by_name('grips data').data;"
        " const row = grips.x.findIndex((_, k) => Math.hypot(grips.x[k] - x, grips.y[k] - y) < 1e-3);"
        " return row >= 0 && grips.line[row] !== grips.fill[row]; }",
        dock,
    )


def test_the_handle_turns_the_robot(page):
    (x, y), _ = page.nose()
    grips = page.data("grips")
    heading = min(zip(grips["x"], grips["y"], strict=True), key=lambda grip: abs(math.dist(grip, (x, y)) - 0.65))
    state, angle = page.state, math.atan2(heading[1] - y, heading[0] - x)
    reach = math.dist(heading, (x, y))
    page.drag(heading, [x + reach * math.cos(angle - 0.4), y + reach * math.sin(angle - 0.4)])
    page.settle_after(state)
    (x1, y1), (fx, fy) = page.nose()
    assert near((x, y), (x1, y1))
    assert math.atan2(fy - y1, fx - x1) == pytest.approx(angle - 0.4, abs=0.03)


def test_a_corner_of_an_obstacle_is_dragged(page):
    state, count = page.state, len(page.data("obstacles")["xs"])
    page.click("Add box")
    page.settle_after(state)
    before, state = page.data("obstacles"), page.state
    assert len(before["xs"]) == count + 1
    corner = [before["xs"][-1][2], before["ys"][-1][2]]
    page.drag(corner, [corner[0] + 0.3, corner[1] + 0.2])
    page.settle_after(state)
    after = page.data("obstacles")
    changed = [k for k in range(4) if after["xs"][-1][k] != before["xs"][-1][k]]
    assert len(changed) == 1
    assert near([after["xs"][-1][changed[0]], after["ys"][-1][changed[0]]], [corner[0] + 0.3, corner[1] + 0.2], 0.02)


def swipe(page, first, last):
    """Move one finger between two points of the window, in pixels."""
    touch = page.page.context.new_cdp_session(page.page)

    def send(kind, *points):
        points = [{"x": x, "y": y} for x, y in points]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    (x, y), (x1, y1) = first, last
    send("touchStart", first)
    for k in range(1, 11):
        send("touchMove", (x + (x1 - x) * k / 10, y + (y1 - y) * k / 10))
    send("touchEnd")


def test_a_finger_drags_the_robot_and_scrolls_elsewhere(opened):
    page = opened(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    place, state = page.robot(), page.state
    end = [place[0] + 0.6, place[1] + 0.5]
    first, last = page.pixel(place), page.pixel(end)
    scrolled = page.page.evaluate("scrollY")
    swipe(page, first, last)
    page.settle_after(state)
    assert near(page.robot(), end, 0.03)
    assert near(page.path_start(), page.robot())
    assert page.page.evaluate("scrollY") == scrolled
    state, (x, y) = page.state, page.pixel(free_place(page))
    scrolled = page.page.evaluate("scrollY")
    swipe(page, (x, y), (x, y - 150))
    page.wait("(before) => scrollY > before + 50", scrolled)
    page.settle()
    assert page.state == state
    assert page.errors == []


def test_a_slider_plans_again(page):
    state = page.state
    before = page.field("clearance [m]").input_value()
    page.pull(page.slider("clearance [m]"), 40)
    page.settle_after(state)
    assert float(page.field("clearance [m]").input_value()) > float(before)
    page.click("Undo")
    page.wait("(state) => document.querySelector('#status p').dataset.scene === state", state)
    page.settle()
    assert page.field("clearance [m]").input_value() == before


@pytest.mark.parametrize("text", ["nan", "-1", "1e400", "", "9" * 5000, HOSTILE, "\u0660.\u0665", "0.1; drop"])
def test_hostile_text_in_a_field_is_refused(page, text):
    state, message = page.state, page.message
    page.enter("clearance [m]", text)
    page.wait("(old) => Bokeh.documents[0].get_model_by_name('message').text !== old", message)
    assert 'role="alert"' in page.message
    assert page.state == state
    page.enter("clearance [m]", "0.011")
    page.settle_after(state)
    assert page.message == ""
    assert page.page.evaluate(INTRUDERS) == [0, 0]


def test_hostile_names_are_refused_and_remain_text(page, program):
    before = sorted(program.folder.iterdir())
    for name in (HOSTILE, "../outside", "/etc/passwd", ".hidden", "a" * 300):
        page.page.get_by_role("textbox", name="name", exact=True).fill(name)
        page.page.get_by_role("textbox", name="name", exact=True).press("Enter")
        page.click("Save")
        page.wait_for_message("must be letters")
        assert page.page.evaluate(INTRUDERS) == [0, 0]
        page.click("Copy link")
        page.wait_for_message("contains the scene")
    assert sorted(program.folder.iterdir()) == before


def test_a_wall_in_front_of_the_dock_is_refused_and_undone(page):
    first = page.state
    page.click("Add wall")
    page.settle_after(first)
    state = page.state
    wall, dock = page.data("obstacles"), page.robot("dock")
    page.drag(middle(wall, -1), [dock[0] - 0.3, dock[1]])
    page.settle_after(state)
    assert page.outcome in ("impossible", "refused")
    places = page.data("places")
    scene = Picture(page, "scene")
    assert scene.share_of(PALETTE["hot"][0], along(places["xs"][0], places["ys"][0]), 4) > 0.8
    check_bodies(page, scene)
    words = page.text("words")
    assert "Reason of the refusal" in words or "Proof that no motion exists" in words
    pictured(page, "refused")
    state = page.state
    page.click("Undo")
    page.settle_after(state)
    page.click("Undo")
    page.wait("(first) => document.querySelector('#status p').dataset.scene === first", first)
    page.settle()
    assert page.outcome == "certified"
    assert page.data("region")["xs"] == []


@pytest.mark.parametrize("stem", [path.stem for path in worked_scenes()])
def test_worked_scenes_are_painted_as_they_are(page, stem):
    state = page.state
    page.choose("scene", stem)
    page.settle_after(state)
    pictured(page, f"scene-{stem}")
    assert page.message == ""
    page.page.evaluate(HIDE)
    scene = Picture(page, "scene")
    check_bodies(page, scene)
    words = page.text("words")
    if stem != "no_way":
        assert page.outcome == "certified"
        assert "at every point of the path" in words.lower()
        assert near(page.path_start(), page.robot())
        check_path(page, scene)
        check_curves(page)
        return
    assert page.outcome == "impossible"
    assert "too wide" in page.page.inner_text("#status")
    assert "Proof that no motion exists" in words
    check_region(page, scene)
    page.click("Undo")
    page.wait("(state) => document.querySelector('#status p').dataset.scene === state", state)
    page.settle()
    assert page.outcome == "certified"


def check_bodies(page, scene):
    """The outlines of the robot at start and dock have their colours, and lines beside them do not."""
    for name, colour in (("start", "start"), ("dock", "goal")):
        body = page.data(f"{name} body")
        outline = along(body["xs"][0], body["ys"][0])
        assert scene.share_of(PALETTE[colour][0], outline) > 0.8
        centre = np.mean(outline, axis=0)
        assert scene.share_of(PALETTE[colour][0], centre + 0.75 * (outline - centre)) < 0.3


def check_path(page, scene):
    """The path is painted in the colours of its gears away from the robots, and not beside it."""
    bodies = [page.data(f"{name} body") for name in ("start", "dock")]
    bodies = [np.column_stack((body["xs"][0], body["ys"][0])) for body in bodies]
    marks = [page.data(name) for name in ("grips", "cusps")]
    discs = [shapely.Point(place) for mark in marks for place in zip(mark["x"], mark["y"], strict=True)]
    covered = shapely.union_all([*map(shapely.Polygon, bodies), *discs]).buffer(0.06)
    shown = 0
    for name, colour in (("forward", "path"), ("reverse", "reverse")):
        line = page.data(name)
        points = [(x, y) for x, y in zip(line["x"], line["y"], strict=True) if x is not None]
        free = [place for place in points if not covered.contains(shapely.Point(place))]
        if len(free) > 8:
            shown += 1
            assert scene.share_of(PALETTE[colour][0], free) > 0.9
            beside = [(x + 0.1, y + 0.1) for x, y in free]
            assert scene.share_of(PALETTE[colour][0], beside) < 0.6
    assert shown


def check_region(page, scene):
    """The closed region is painted in its colour inside, and nothing outside of it."""
    columns = page.data("region")
    polygons = zip(columns["xs"], columns["ys"], strict=True)
    rings = [
        [np.column_stack(ring) for ring in zip(xs, ys, strict=True)]
        for multi in polygons
        for xs, ys in zip(*multi, strict=True)
    ]
    region = shapely.union_all([shapely.Polygon(first, holes) for first, *holes in rings])
    names = ("start body", "dock body", "station", "obstacles", "places")
    layers = [page.data(name) for name in names]
    bodies = [list(zip(x, y, strict=True)) for one in layers for x, y in zip(one["xs"], one["ys"], strict=True)]
    grips = page.data("grips")
    discs = [shapely.Point(place) for place in zip(grips["x"], grips["y"], strict=True)]
    lines = shapely.union_all([*map(shapely.Polygon, bodies), *discs, region.boundary]).buffer(0.15)
    places = [(x, y) for x in np.arange(-2.9, 3.0, 0.1) for y in np.arange(-2.0, 2.0, 0.1)]
    free = [place for place in places if not lines.contains(shapely.Point(place))]
    inside = [place for place in free if region.contains(shapely.Point(place))]
    outside = [place for place in free if not region.contains(shapely.Point(place))]
    colour = mixture(PALETTE["impossible"][0], PALETTE["paper"][0], 0.45)
    assert min(len(inside), len(outside)) > 100
    assert scene.share_of(colour, inside, 1) > 0.95
    assert scene.share_of(colour, outside, 1) == 0.0


def check_curves(page):
    """The speed and its limit are painted in the first chart."""
    chart = Picture(page, "speed [m/s]")
    data = page.page.evaluate(SPEED)
    curve = np.column_stack((data["at"], data["value"]))
    assert chart.share_of(PALETTE["path"][0], curve) > 0.95
    assert chart.share_of(PALETTE["path"][0], np.add(curve, (0.0, 0.15))) < 0.4
    limit = [(x, y) for x, y in zip(data["at"], data["upper"], strict=True) if y is not None]
    assert chart.share_of(PALETTE["limit"][0], limit, 4) > 0.1  # dashed, and mixed with the paper


def test_a_stale_picture_is_faded_until_the_next_one(page, program):
    """The planning process is stopped, so that the answer to a change does not arrive."""
    state = page.state
    page.choose("scene", "reverse_bay")
    page.settle_after(state)
    path = [(x, y) for x, y in zip(*page.data("forward").values(), strict=True) if x is not None][20:-20]
    faded = mixture(PALETTE["path"][0], PALETTE["paper"][0], 0.35)
    page.page.evaluate(HIDE)
    assert Picture(page, "scene").share_of(PALETTE["path"][0], path) > 0.9
    found = Path(f"/proc/{program.process.pid}/task").glob("*/children")
    children = {int(child) for listed in found for child in listed.read_text().split()}
    try:
        for child in children:
            os.kill(child, signal.SIGSTOP)
        state = page.state
        page.click("→")
        page.wait("(old) => document.querySelector('#status p').dataset.scene !== old", state)
        page.wait(
            "() => Bokeh.documents[0].get_model_by_name('scene').center.some((one) => one.fill_alpha === 0.65"
            " && one.visible)"
        )
        assert page.status("shown") == state
        stale = Picture(page, "scene")
        assert stale.share_of(faded, path) > 0.9
        assert stale.share_of(PALETTE["path"][0], path) == 0.0
        check_start(page, stale)
    finally:
        for child in children:
            os.kill(child, signal.SIGCONT)
    page.settle()
    path = [(x, y) for x, y in zip(*page.data("forward").values(), strict=True) if x is not None][20:-20]
    assert Picture(page, "scene").share_of(PALETTE["path"][0], path) > 0.9


def check_start(page, scene):
    body = page.data("start body")
    assert scene.share_of(PALETTE["start"][0], along(body["xs"][0], body["ys"][0])) > 0.8


def mixture(colour, paper, share):
    pairs = [(int(colour[k : k + 2], 16), int(paper[k : k + 2], 16)) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(share * ink + (1 - share) * under):02X}" for ink, under in pairs)


def test_keys_move_turn_remove_and_undo(page):
    def press(key):
        state = page.state
        page.page.keyboard.press(key)
        page.settle_after(state)

    place, first = page.robot(), page.state
    page.page.focus("#figure")
    press("ArrowRight")
    assert near(page.robot(), [place[0] + 0.05, place[1]])
    press("ArrowDown")
    assert near(page.robot(), [place[0] + 0.05, place[1] - 0.05])
    (x, y), (fx, fy) = page.nose()
    press("q")
    (x1, y1), (gx, gy) = page.nose()
    turn = math.atan2(gy - y1, gx - x1) - math.atan2(fy - y, fx - x)
    assert turn == pytest.approx(math.radians(5.0), abs=1e-3)
    for _ in range(3):
        press("z")
    assert page.state == first
    page.click("Add box")
    page.settle_after(first)
    added = page.state
    count = len(page.data("obstacles")["xs"])
    page.page.mouse.click(*page.pixel(middle(page.data("obstacles"), -1)))
    page.wait(f"() => Bokeh.documents[0].get_model_by_name('names data').data.text.includes('obstacles[{count - 1}]')")
    page.page.focus("#figure")
    press("Delete")
    assert len(page.data("obstacles")["xs"]) == count - 1
    assert page.state == first
    press("z")
    assert page.state == added


def test_every_button_is_reached_by_tab(page):
    buttons = {one.inner_text().strip() for one in page.page.get_by_role("button").all() if one.is_visible()}
    assert {"Undo", "Drive", "Save"} <= buttons
    page.page.focus("#figure")
    reached = set()
    for _ in range(150):
        page.page.keyboard.press("Tab")
        reached.add(page.page.evaluate(FOCUSED))
    assert buttons - reached == set()


def test_two_tabs_are_independent(page, opened):
    other = opened()
    state = page.state
    assert other.state == state
    other.click("→")
    other.settle_after(state)
    assert page.state == state
    page.click("↓")
    page.settle_after(state)
    assert page.state != other.state
    assert not near(page.robot(), other.robot())
    assert other.errors == []


@pytest.mark.parametrize(("stem", "version"), [("reverse_bay", "1."), ("", "2.")])
def test_the_address_contains_the_scene(page, opened, stem, version):
    if stem:
        state = page.state
        page.choose("scene", stem)
        page.settle_after(state)
    state = page.state
    page.click("→")
    page.settle_after(state)
    edited = page.state
    page.wait("(version) => new URL(location).searchParams.get('scene')?.startsWith(version)", version)
    address = page.page.url
    page.page.reload()
    page.settle()
    assert page.state == edited
    copy = opened(f"?{address.partition('?')[2]}")
    assert copy.state == edited
    assert near(copy.robot(), page.robot())


@pytest.mark.parametrize(
    "query",
    ["?scene=nothing", "?scene=1.AAAA", f"?scene={HOSTILE}", "?file=../../etc/passwd", "?file=/etc/passwd",
     f"?file={HOSTILE}", f"?file={'a' * 5000}", "?scene=1." + "A" * 20_000],
)  # fmt: skip
def test_a_hostile_address_shows_a_message_and_the_first_scene(opened, query):
    first = opened().state
    page = opened(query)
    assert 'role="alert"' in page.message
    assert page.state == first
    assert page.page.evaluate(INTRUDERS) == [0, 0]
    assert page.errors == []


def test_a_lost_connection_is_reported_with_the_fate_of_the_scene(opened, tmp_path):
    (tmp_path / "own").mkdir()
    far = [[[20.0 + 1e-6 * k**2, 20.0 + k], [20.5, 20.0 + k], [20.0, 20.1234567 + k]] for k in range(1200)]
    text = f"{SCENE.partition('obstacles:')[0]}obstacles: {far}\nrobot:{SCENE.partition('robot:')[2]}"
    (tmp_path / "own" / "large.yaml").write_text(text)
    program = Program(tmp_path / "own")
    try:
        page, large = opened(url=program.url), opened("?file=large.yaml", url=program.url)
        assert not page.page.is_visible("#lost")
        assert not page.page.is_visible(".unlinked")
        assert "save the scenario" in large.page.inner_text(".unlinked")
        program.kill()
        for one, fate in ((page, "opens this scene again"), (large, "not saved are lost")):
            one.page.wait_for_selector("#lost", state="visible")
            assert fate in one.page.inner_text("#lost")
            assert len(one.page.inner_text("#lost")) < 300
        assert [error for error in page.errors if error.startswith("page:")] == []
        page.press(page.robot())  # nor does the page fail afterwards
        page.page.mouse.up()
        assert [error for error in page.errors if error.startswith("page:")] == []
    finally:
        program.end()


def test_a_simulated_drive_ends_and_is_played(page):
    page.click("Drive")
    page.wait_for_message("simulated drive: docked")
    page.settle()
    drive = page.data("drive")
    assert near([drive["x"][0], drive["y"][0]], page.robot(), 0.05)
    assert near([drive["x"][-1], drive["y"][-1]], page.robot("dock"), 0.2)
    ghost = page.data("ghost")
    page.pull(page.page.get_by_role("slider").first, 150)
    page.wait("() => Bokeh.documents[0].get_model_by_name('player').value > 0")
    assert page.data("ghost") != ghost
    spans, value, _ = page.page.evaluate(CURSORS)
    assert len(spans) >= 4
    assert len(set(spans)) == 1
    assert spans[0] > 0.0
    page.click("Play")
    page.wait("(value) => Bokeh.documents[0].get_model_by_name('player').value > value", value)
    page.click("Play")
    spans, _, _ = page.page.evaluate(CURSORS)
    assert len(set(spans)) == 1
    pictured(page, "driven")


def test_saved_files_are_accepted_by_certify(opened, tmp_path):
    (tmp_path / "own").mkdir()
    program = Program(tmp_path / "own")
    try:
        page = opened(url=program.url)
        page.click("Save")
        page.wait_for_message("saved: scene.yaml")
        assert (program.folder / "scene.html").stat().st_size > 10_000
        plan, scenario = (str(program.folder / f"scene.{end}") for end in ("json", "yaml"))
        done = CliRunner().invoke(app, ["certify", plan, scenario])
        assert done.exit_code == 0, done.output
        page.click("Save")
        page.wait_for_message("scene.yaml exists")
        page.page.get_by_role("checkbox").check()
        page.click("Save")
        page.wait_for_message("saved: scene.yaml")
        assert page.errors == []
    finally:
        program.end()
