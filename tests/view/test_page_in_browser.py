"""The page where people look at it: Debian's Chromium opens it, clicks, slides, searches and compares."""

import json
import re
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from support.browser import PATIENCE_MS, browser
from support.notices import with_notices
from support.towns import EPSG, ROW, town_build

from msbdb import api
from msbdb.database import open_database, write_build
from msbdb.errors import MissingDependencyError
from msbdb.run import townpage as made
from msbdb.view.page import as_data, read_library

pytestmark = pytest.mark.long

HOSTILE = "</script><script>document.title='hacked'</script><img src=x onerror=\"document.title='hacked'\">"
TOWER = [*ROW[1:7], (150, 10, 162, 22, 18), (20, 60, 60, 100, 8), (30, 70, 45, 85, 30), (100, 60, 115, 75, 9)]


@pytest.fixture(scope="module", params=["whole", "tiled"])
def address(request, tmp_path_factory):
    """Return where the page of a town is that two surveys saw, as a small one and as a large one with tiles.

    The first survey has a hostile name.
    """
    try:
        read_library()
    except MissingDependencyError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("page")
    engine = open_database(folder / "town.sqlite", create=True, srid=EPSG)
    for name, date, houses in ((HOSTILE, "2020-05-01", [*ROW, (20, 60, 60, 100, 8)]), ("second", "2022-05-01", TOWER)):
        write_build(engine, town_build(name, date, houses))
        api.advance(engine.url, name)
    engine.dispose()
    with pytest.MonkeyPatch.context() as patched:
        if request.param == "tiled":
            patched.setattr(made, "FEW_PARTS", 10)
        with_notices(api.view, folder / "town.sqlite", folder / "town.html")
    return (folder / "town.html").as_uri()


@pytest.fixture(scope="module")
def chromium():
    """Return a browser for all tests."""
    with browser() as started:
        yield started


@pytest.fixture
def opened(chromium, address):
    """Return the opened page, and fail the test for a message on its console, an error, or a request to a network."""
    page = chromium.new_page(viewport={"width": 1000, "height": 700})
    page.set_default_timeout(PATIENCE_MS)
    complaints = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: re.match("file|data|blob", request.url) or complaints.append(request.url))
    page.goto(address)
    page.wait_for_selector("html[data-ready]")
    yield page
    assert complaints == []
    page.close()


def picture(page):
    """Return what the browser shows."""
    from io import BytesIO

    from matplotlib.image import imread

    return imread(BytesIO(page.screenshot()))


def warm(page):
    """Return the share of the picture in the colours of heights, right of the panel."""
    image = picture(page)[:, 300:]
    return float(np.mean(image[..., 0] - image[..., 2] > 0.25))


def slide(page, value):
    """Move the slider of scales."""
    page.locator("#scale").fill(str(value))


def middle(page):
    """Open the building in the middle of the map by the keyboard."""
    page.locator("#map-a canvas").focus()
    page.keyboard.press("Enter")


def address_of(page):
    """Return the part of the address that keeps the view."""
    return page.evaluate("location.hash")


def centre(address):
    """Return the longitude and latitude that an address keeps."""
    return np.array(address.split("at=")[1].split("&")[0].split("+")[:2], dtype=float)


def until(holds, seconds=60.0):
    """Wait until something holds, and return whether it does."""
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.2)
    return bool(holds())


def test_the_town_is_drawn_in_its_colours(opened):
    """The picture has the colours of heights; without the layer of buildings it has none."""
    assert warm(opened) > 0.01
    opened.uncheck("input[name=blocks]")
    assert until(lambda: warm(opened) < 0.001)


def test_a_building_is_found_by_its_id_and_by_the_keyboard(opened):
    """Search goes there; then Enter on the map opens what is in its middle; Escape closes it."""
    key = opened.evaluate("JSON.parse(document.getElementById('town').textContent).buildings.id.at(-1)")
    opened.keyboard.press("/")
    opened.keyboard.type(key[:8])
    opened.keyboard.press("Enter")
    assert opened.locator("#details-title").text_content() == f"Building {key}"
    assert opened.locator("#details .tree button").count() >= 1
    assert "History" in opened.locator("#details-body").text_content()
    opened.wait_for_timeout(1500)  # the camera moves there
    opened.keyboard.press("Escape")
    assert opened.locator("#details").is_hidden()
    opened.click("#flat")
    opened.wait_for_timeout(1500)
    middle(opened)
    assert opened.locator("#details-title").text_content() == f"Building {key}"
    assert until(lambda: f"id={key}" in address_of(opened))


def test_a_building_is_seen_and_found_from_afar(chromium, opened, address):
    """Where a pixel is several metres, the middle of the map still is the building that a search went to."""
    key = opened.evaluate("JSON.parse(document.getElementById('town').textContent).buildings.id.at(-2)")
    opened.locator("#query").fill(key)
    opened.keyboard.press("Enter")

    def arrived():
        address = address_of(opened)
        opened.wait_for_timeout(1500)
        return f"id={key}" in address and address == address_of(opened)

    assert until(arrived)
    place = "+".join(f"{number:.6f}" for number in centre(address_of(opened)))
    page = chromium.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{address}#at={place}+13.20+0+0")
    page.wait_for_selector("html[data-ready]")
    middle(page)
    assert page.locator("#details-title").text_content() == f"Building {key}", place
    page.close()


def test_a_click_beside_the_buildings_gives_the_place(opened):
    """Without a building the page has the coordinates, and the command that explains them."""
    opened.mouse.click(640, 40)
    assert opened.locator("#details-title").text_content() == "No building here"
    assert "msbdb why DB --at" in opened.locator("#details-body").text_content()


def test_the_slider_walks_the_scales(opened):
    """Each step has its words; the address keeps it, also through the keys."""
    finest = int(opened.locator("#scale").get_attribute("max"))
    slide(opened, 0)
    assert "buildings as blocks" in opened.locator("#scale-words").text_content()
    opened.locator("#colour").select_option("scale")
    opened.locator("#map-a canvas").focus()
    opened.keyboard.press("]")
    assert opened.locator("#scale-words").text_content().startswith(f"1 of {finest}")
    assert until(lambda: "scale=1" in address_of(opened) and "colour=scale" in address_of(opened))


@pytest.mark.parametrize("colour", ["storeys", "scale", "class", "probability", "state", "change"])
def test_every_colour_has_a_legend(opened, colour):
    """The legend has a title and a key or a bar."""
    opened.locator("#colour").select_option(colour)
    assert opened.locator("#legend-title").text_content()
    assert opened.locator("#legend .key, #legend .bar").count() >= 1


def test_two_dates_stand_side_by_side(opened):
    """Both maps move together; the list of changes has as many rows as the legend counts; hostile names are text."""
    opened.locator("#other").select_option("0")
    opened.wait_for_selector("#pane-b canvas")
    assert HOSTILE in opened.locator("#tag-a").text_content()
    assert opened.title() != "hacked"
    assert opened.locator("#panel img").count() == 0
    listed = opened.locator("#change-list li").count()
    assert listed >= 3
    assert f"{listed} changes" in opened.locator("#changes-title").text_content()
    assert until(lambda: "other=0" in address_of(opened))
    before = centre(address_of(opened))
    opened.locator("#change-list button").first.click()
    assert opened.locator("#details").is_visible()
    assert until(lambda: np.abs(centre(address_of(opened)) - before).max() > 1e-4), "the camera goes there"


def test_a_link_keeps_the_view(chromium, address):
    """The page opened by its address shows the same scale, colour, building and theme."""
    page = chromium.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{address}#at=3.0005+36.1435+17.50+10+30&view=1&colour=state&scale=2&hidden=reasons&theme=dark")
    page.wait_for_selector("html[data-ready]")
    assert page.locator("#colour").input_value() == "state"
    assert page.locator("#scale").input_value() == "2"
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.click("#theme")
    assert until(lambda: "theme=light" in address_of(page))
    assert "at=3.0005" in address_of(page)
    page.close()


def test_blocks_stand_at_the_level_of_their_ground(chromium, address, tmp_path):
    """With slopes, buildings of the east whose ground is 60 m higher go up against those of the west."""
    text = Path(unquote(urlsplit(address).path)).read_text(encoding="utf-8")
    data = re.search('<script id="town" type="application/json">(.*?)</script>', text)[1]
    town = json.loads(data)
    wests = [box[0] for box in town["buildings"]["box"]] if "box" in town["buildings"] else [
        shape[0][0][0] for shape in town["buildings"]["shape"]
    ]  # fmt: skip
    middle_of = (min(wests) + max(wests)) / 2
    town["buildings"]["values"]["z_ground"] = [6000 if west > middle_of else 0 for west in wests]
    (tmp_path / "hills.html").write_text(text.replace(data, as_data(town)), encoding="utf-8")
    page = chromium.new_page(viewport={"width": 1000, "height": 700})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{(tmp_path / 'hills.html').as_uri()}#theme=light")
    page.wait_for_selector("html[data-ready]")

    def rise():
        image = picture(page)[:, 310:]
        rows, cols = np.nonzero(image[..., 0] - image[..., 2] > 0.25)
        half = (cols.min() + cols.max()) / 2
        return rows[cols < half].mean() - rows[cols >= half].mean()

    before = rise()
    page.check("input[name=slopes]")
    assert until(lambda: rise() > before + 30)
    page.uncheck("input[name=slopes]")
    assert until(lambda: abs(rise() - before) < 5)
    page.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_is_accessible(chromium, address, theme):
    """Axe finds nothing, with a building open and two dates side by side."""
    from axe_playwright_python.sync_playwright import Axe

    context = chromium.new_context(bypass_csp=True)  # axe's own script is no part of the page
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{address}#theme={theme}&view=1&other=0&colour=change")
    page.wait_for_selector("html[data-ready]")
    page.locator("#change-list button").first.click()
    found = Axe().run(page).response
    assert len(found["passes"]) > 20
    assert [(rule["id"], [node["html"][:100] for node in rule["nodes"]]) for rule in found["violations"]] == []
    context.close()
