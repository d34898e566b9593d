"""Lengths on the page, against `measure` of the same model and field."""

import json

import numpy as np
import pytest
from conftest import Page, run
from test_view import press, splats, voxels, wait

#: Largest ratio of the page's deviation to the program's, either way: in the median and of the worst of eight points.
#: Cells of the page's volume are interpolated, and round what the program computes; the page has the U of splats at
#: their middles, and not at the depth of the ray.
RATIOS = {"voxels": (1.05, 1.1), "splats": (1.3, 1.7)}


@pytest.fixture(scope="module", params=[voxels, splats], ids=lambda make: make.__name__)
def scene(request, tmp_path_factory):
    scene = request.param(tmp_path_factory.mktemp("measured"))
    scene.name = request.param.__name__
    run(scene.folder, f"uncertainty {scene.model} {scene.options} --for depth --rays 60000 --noise 0.03 -o depth.oct")
    run(scene.folder, f"view {scene.model} depth.oct {scene.options} --metres-per-unit 2 -o depth.html")
    return scene


@pytest.fixture(scope="module")
def page(scene, browser):
    page = Page(browser, scene.folder / "depth.html")
    assert page.said == "ready", page.said
    page.camera(1)
    return page


def measured(scene, a, b):
    places = " ".join(",".join(f"{2 * v:.6f}" for v in end["position"]) for end in (a, b))
    return json.loads(
        run(scene.folder, f"measure {scene.model} depth.oct {places} {scene.options} --metres-per-unit 2 --json")
    )


def test_lengths_are_those_of_measure(scene, page):
    page.do("document.getElementById('measure').checked || document.getElementById('measure').click()")
    width, height = page.size
    ratios, ends = [], []
    for x, y in [(0.4, 0.4), (0.5, 0.45), (0.6, 0.4), (0.42, 0.5), (0.5, 0.55), (0.58, 0.5), (0.45, 0.6), (0.55, 0.62)]:
        page.do("v.mark(arguments[0], arguments[1])", x * width, y * height)
        ends.append(page.do("return v.ends.at(-1)"))
    assert page.do("return v.ends.length") == 2, "a third click begins anew"
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        found = measured(scene, a, b)
        line = np.subtract(b["position"], a["position"])
        assert np.isclose(found["length"], 2 * np.linalg.norm(line), atol=0.02 * found["length"])
        for end, point in zip((a, b), found["points"], strict=True):
            assert np.allclose(np.multiply(2, end["position"]), point["position"], atol=0.02)
            ratios.append(2 * end["sigma"] / point["sigma"])
    ratios = np.maximum(ratios, 1 / np.array(ratios))
    print(scene.name, np.round(np.sort(ratios), 2))
    middle, worst = RATIOS[scene.name]
    assert np.median(ratios) < middle and ratios.max() < worst


def test_two_clicks_measure_and_the_line_is_drawn(page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    page.camera(1)
    box = page.driver.find_element(By.ID, "measure")
    if box.is_selected():
        box.click()
    drawn = (
        "v.draw(); return v.overlay.getContext('2d').getImageData(0, 0, v.overlay.width, v.overlay.height).data"
        ".some((n) => n > 0)"
    )
    said = lambda: page.do("return document.getElementById('length').textContent")
    assert not page.do(drawn) and said() == ""
    press(page, "m")
    area = page.driver.find_element(By.ID, "area")
    before = page.do("return v.camera.position")
    for x, words in [(-30, "Click the other end"), (40, " m (90 %)")]:
        ActionChains(page.driver).move_to_element_with_offset(area, x, 10).click().perform()
        wait(page, f"return document.getElementById('length').textContent.includes('{words}')")
    a, b = page.do("return v.ends")
    length, wide = (float(word) for word in said().splitlines()[-1].removesuffix(" m (90 %)").split(" ± "))
    assert abs(length - 2 * np.linalg.norm(np.subtract(b["position"], a["position"]))) < wide
    assert page.do(drawn) and page.do("return v.camera.position") == before
    press(page, "m")
    assert not page.do(drawn) and said() == ""
    assert page.console() == []


def test_where_no_deviation_is_known_it_says_why(scene, browser):
    # The field of the paper's scale, in which U is no length.
    page = Page(browser, scene.html)
    page.camera(1)
    page.do("document.getElementById('measure').click()")
    width, height = page.size
    for x in (0.45, 0.55):
        page.do("v.mark(arguments[0], arguments[1])", x * width, 0.5 * height)
    said = page.do("return document.getElementById('length').textContent").splitlines()[-1]
    assert "scene units, without a deviation" in said and "uncertainty --for depth" in said
