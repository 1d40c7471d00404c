"""The page in a browser: on a phone, a tablet and a desk, light and dark, and on paper.

With the system's Chromium; nothing is downloaded. Where there is none the tests are skipped, unless
UNBEND_BROWSER is set, as `.ci/run` does.
"""

import json
import os
import re
import shutil

import numpy as np
import pytest
import yaml

from tests.golden.conftest import sample_sections, write_mission
from tests.stages.terrain_models import terrain_grid
from tests.tables.geodata.rasters import write_raster
from unbend import run_mission
from unbend.simulate.flight import FIELD_LAT_RAD, FIELD_LON_RAD

WIDTHS = (390, 768, 1280)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("UNBEND_BROWSER"),
    reason="no chromium is installed (Debian: apt-get install chromium)",
)


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM is not None, "UNBEND_BROWSER is set, but no chromium is installed"
    with sync_playwright() as started:
        arguments = ["--no-sandbox", "--disable-gpu"]
        running = started.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield running
        running.close()


def with_model_and_flagged_rows(mission):
    """A mission on an elevation model that covers a part of it, with rows that are no use."""
    lon_deg = np.degrees(FIELD_LON_RAD) + 0.061
    lat_deg = np.degrees(FIELD_LAT_RAD) + 0.019
    heights, cells = terrain_grid("EPSG:4326", lon_deg, lat_deg, 22.5)
    write_raster(mission.folder / "dem.tif", heights.astype(np.float32), cells)
    mission.config["ground"] = {"height": {"dem": "dem.tif"}, "reference": "msl", "sigma_m": 1.5}
    table = mission.measured_rows()
    table.loc[table.index[::9], "x_px"] = 99_999.0
    table.loc[table.index[4::31], "y_px"] = np.nan
    first = table["image"].iloc[0]
    table.loc[table["image"] == first, "image"] = "a_name_of_an_image_that_nobody_shortened_" * 3
    table.to_parquet(mission.folder / "own.parquet")
    mission.config["observations"]["path"] = "own.parquet"
    mission.run_to_manifest(3)
    return mission.output


def without_log(mission, baseline):
    """A mission whose stations are a table, in the air of a standard."""
    for section in ("log", "mount", "events"):
        del mission.config[section]
    for camera in mission.config["cameras"].values():
        del camera["window"]
    stations = baseline.station_rows().drop(columns=["time_utc", "geometry"])
    stations.to_csv(mission.folder / "stations.csv", index=False)
    mission.config["stations"] = yaml.safe_load("""
    orientation:
      path: stations.csv
      angles: quaternion
      frame: geographic
      heights: msl
      columns: {camera: camera, latitude: lat_deg, longitude: lon_deg, height: h_msl_m}
    """)
    mission.config["atmosphere"] = {"adjust": False}
    mission.run_to_manifest()
    return mission.output


def sample(folder):
    """The sample mission of a log of ArduPilot."""
    sections = sample_sections("bin", folder / "sample")
    return run_mission(write_mission(folder / "sample.yaml", **sections)).output


@pytest.fixture(scope="module")
def runs(mission_factory, baseline, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    return {
        "sample": sample(folder),
        "small": baseline.output,
        "model": with_model_and_flagged_rows(mission_factory(folder / "model")),
        "no log": without_log(mission_factory(folder / "none", "tlog"), baseline),
    }


def opened(browser, run, **options):
    """The report of a run on a page of its own."""
    page = browser.new_page(**options)
    page.goto((run / "report.html").resolve().as_uri())
    return page


# Elements that stand out of the screen or of their drawing, and texts that do not fit theirs.
LOOK = """() => {
  const wide = document.documentElement.clientWidth, out = [], seen = e => e.checkVisibility();
  const aside = e => e && getComputedStyle(e).position === "absolute";  // heads of cards, for ears
  for (const e of document.querySelectorAll("body *")) {
    if (!seen(e) || e.closest("[aria-hidden]") || aside(e.closest("thead"))) continue;
    const box = e.getBoundingClientRect();
    if (box.right > wide + 0.5 || box.left < -0.5)
      out.push([e.tagName, e.getAttribute("class"), box.left, box.right, e.textContent].join(" "));
    if (!(e instanceof SVGElement) && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0)
      out.push(`${e.tagName} ${e.scrollWidth} in ${e.clientWidth}: ${e.textContent.slice(0, 40)}`);
  }
  for (const svg of document.querySelectorAll("figure > svg")) {
    if (!seen(svg)) continue;
    const frame = svg.getBoundingClientRect();
    for (const text of svg.querySelectorAll("text")) {
      const box = text.getBoundingClientRect();
      if (box.right > frame.right + 1 || box.left < frame.left - 1 || box.top < frame.top - 1 ||
          box.bottom > frame.bottom + 1)
        out.push(`text ${text.textContent} leaves its drawing: ${box.left - frame.left}`);
    }
  }
  return out;
}"""

# Ratio of the luminances of text and ground (WCAG 2), the lowest of all texts that are shown.
CONTRAST = """() => {
  const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
      .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const paper = light(getComputedStyle(document.body).backgroundColor);
  let worst = [99, ""];
  const texts = "p, li, td, th, dd, dt, h1, h2, h3, a, code, text, summary, figcaption";
  for (const e of document.querySelectorAll(texts)) {
    if (!e.checkVisibility() || !e.textContent.trim()) continue;
    const style = getComputedStyle(e);
    const ink = light(e instanceof SVGElement ? style.fill : style.color);
    const ratio = (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
    if (ratio < worst[0]) worst = [ratio, `${e.tagName} ${e.textContent.slice(0, 40)}`];
  }
  return worst;
}"""

DRAWN = ("map", "height", "size", "field", "air", "ground")


@pytest.mark.parametrize("name", ["sample", "small", "model", "no log"])
def test_nothing_is_wider_than_the_screen(runs, browser, name):
    file = (runs[name] / "report.html").resolve()
    for scheme in ("light", "dark"):
        page = browser.new_page(color_scheme=scheme)
        messages = []
        asked = []
        page.on("console", lambda message, messages=messages: messages.append(message.text))
        page.on("pageerror", lambda error, messages=messages: messages.append(str(error)))
        page.on("request", lambda request, asked=asked: asked.append(request.url))
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            page.goto(file.as_uri())
            assert page.evaluate(LOOK) == [], f"{width} px, {scheme}"
            shown = page.locator("figure > svg:visible")
            classes = shown.evaluate_all("all => all.map(e => e.getAttribute('class'))")
            assert set(classes) == {"narrow" if width == 390 else "wide"}
            figures = page.locator("figure").evaluate_all("all => all.map(e => e.id)")
            assert set(DRAWN) <= {figure.removeprefix("figure-") for figure in figures}
            # Numbers at axes are drawn at eight pixels or more, not shrunk with the screen.
            sizes = shown.evaluate_all(
                "all => all.map(e => 11 * e.clientWidth / e.viewBox.baseVal.width)"
            )
            assert min(sizes) >= 10.0
            # Open, the tables of data fit too.
            page.evaluate("for (const e of document.querySelectorAll('details')) e.open = true")
            assert page.evaluate(LOOK) == [], f"{width} px, {scheme}, all open"
            ratio, place = page.evaluate(CONTRAST)
            assert ratio >= 4.5, place
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", paper)[:3])) < 150) == (scheme == "dark")
        assert (messages, [url for url in asked if not url.startswith(("file:", "data:"))]) == (
            [],
            [],
        )
        page.close()


@pytest.mark.parametrize("name", ["sample", "model"])
def test_a_drawing_has_a_text_in_its_place_and_follows_the_colours(runs, browser, name):
    page = opened(browser, runs[name], viewport={"width": 1280, "height": 900})
    labels = page.locator("figure > svg:visible").evaluate_all(
        "all => all.map(e => [e.getAttribute('role'), (e.getAttribute('aria-label') || '').length])"
    )
    assert all(role == "img" and length > 30 for role, length in labels)
    colours = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        colours.append(
            page.evaluate(
                "[...document.querySelectorAll('figure > svg.wide *')].map(e => "
                "getComputedStyle(e)).map(s => s.stroke + s.fill)"
            )
        )
    assert not set(colours[0]) & set(colours[1]) - {"nonenone", "nonergb(0, 0, 0)"}
    page.close()


def test_on_paper_no_head_is_left_alone_and_nothing_is_cut(runs, browser, tmp_path):
    size = {"width": 680, "height": 900}
    page = opened(browser, runs["model"], viewport=size, color_scheme="dark")
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(LOOK) == []
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    style = page.evaluate(
        "[getComputedStyle(document.querySelector('thead')).display, "
        "getComputedStyle(document.querySelector('tr')).breakInside, "
        "getComputedStyle(document.querySelector('h2')).breakAfter, "
        "getComputedStyle(document.querySelector('figure')).breakInside]"
    )
    assert style == ["table-header-group", "avoid", "avoid", "avoid"]
    content = page.pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True)
    assert content.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 20
    page.close()


# Margin boxes of all pages: the page's selector, the box and its content.
HEADS = """() => [...document.styleSheets].flatMap(sheet => [...sheet.cssRules])
  .filter(rule => rule.constructor.name === "CSSPageRule")
  .flatMap(page => [...(page.cssRules || [])]
    .map(box => [page.selectorText, box.name, box.style.content]))
  .filter(box => box[2])"""


def test_heads_and_page_numbers_on_paper(browser, mission_factory, unbend, tmp_path):
    """A title with all that could end a style sheet is a head as it is; not on the first page."""
    named = mission_factory(tmp_path / "named")
    named.config["mission"] |= {"title": 'Los "3" </style> \\2', "client": "Amt für Geo"}
    named.run_to_manifest()
    page = opened(browser, named.output)
    heads = {(selector, name): content for selector, name, content in page.evaluate(HEADS)}
    assert json.loads(heads["", "top-left"]) == 'Los "3" </style> \\2'
    assert heads["", "top-right"] == '"Amt für Geo"'
    assert 'counter(page) " of " counter(pages)' in heads["", "bottom-right"]
    assert heads[":first", "top-left"] == "none"
    page.close()
    ended = unbend("report", named.output, "--pdf", "--out", tmp_path / "r.pdf", "--timeout", "300")
    assert ended.code == 0, ended.text
    content = (tmp_path / "r.pdf").read_bytes()
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 20
