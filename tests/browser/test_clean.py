"""The page of `clean` in a real browser: the slider and the views change what is shown."""

import numpy as np
from conftest import run
from selenium.webdriver.common.keys import Keys
from test_view import cameras

STATE = """
    const source = (id) => document.getElementById(id).src;
    const lines = [...document.querySelectorAll('#lines li')].map((line) => line.textContent);
    const [name, after] = ['name', 'after'].map((id) => document.getElementById(id));
    return [name.textContent, source('before'), source('marked'), source('after'), lines, after.naturalWidth];
"""


def page(folder):
    """A ball, and fog beside it in front of two of six cameras."""
    at = np.stack(np.meshgrid(*[np.linspace(-1.5, 1.5, 48)] * 3, indexing="ij"), axis=-1)
    fog = np.linalg.norm(at - [0.95, 0, 0], axis=-1) < 0.2
    density = np.where(np.linalg.norm(at, axis=-1) < 0.7, 80, 1.5 * fog)
    color = np.full(at.shape, 0.5)
    box = np.array([[-1.5] * 3, [1.5] * 3], dtype="f4")
    np.savez(folder / "model.npz", density=density.astype("f4"), color=color.astype("f4"), box=box)
    run(folder, f"clean model.npz --cameras {cameras(folder)} --strength strong -o clean.npz --page clean.html")
    return folder / "clean.html"


def test_slider_and_views_change_the_pictures(browser, tmp_path):
    browser.get_log("browser")
    browser.get(page(tmp_path).as_uri())
    strong = browser.execute_script(STATE)
    assert strong[0] == "strong" and strong[4][0].endswith("%)") and strong[5] > 0
    slider = browser.find_element("id", "strength")
    slider.send_keys(Keys.HOME)
    careful = browser.execute_script(STATE)
    assert careful[0] == "careful" and careful[1] == strong[1] and careful[4] != strong[4]
    assert careful[2] != strong[2] or careful[3] != strong[3]
    # What goes is marked, and is no longer there: three different pictures.
    assert len({careful[1], careful[2], careful[3]}) == 3
    buttons = browser.find_elements("css selector", "#views button")
    assert len(buttons) == 4
    buttons[-1].click()
    other = browser.execute_script(STATE)
    assert other[0] == "careful" and other[1] != careful[1]
    assert [button.get_attribute("aria-pressed") for button in buttons] == ["false"] * 3 + ["true"]
    assert "floating" in browser.find_element("id", "legend").text
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
