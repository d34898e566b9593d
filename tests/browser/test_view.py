"""The viewer in a real browser, against `render` and `query` of the same model."""

import base64
import io

import numpy as np
import pytest
from conftest import DATA, Page, Scene, SplatsScene
from PIL import Image

COMMON = "--rays 60000 --level 6"
LEGO = "ppng-pretrained/NeRFSynthetic/ppng_2/lego.ppng"


def lego(folder):
    if DATA is None:
        pytest.skip("OCTOBAYES_DATA names no folder")
    scene = Scene(folder, f"{DATA}/{LEGO}", "--fov 39.6", "--rays 100000 --level 7")
    # What docs/src/view.md promises for a file that can be mailed: its detail is finer than a cell.
    scene.within, scene.median = 0.64, 0.08
    return scene


def voxels(folder):
    """A grid of voxels that holds a hollow bumpy ball, with colours that say where one is."""
    at = np.stack(np.meshgrid(*[np.linspace(-1, 1, 64)] * 3, indexing="ij"), axis=-1)
    radius = np.linalg.norm(at, axis=-1) + 0.05 * np.sin(9 * at).prod(axis=-1)
    density = 120 / (1 + np.exp(60 * (np.abs(radius - 0.55) - 0.05)))
    color = 0.5 + 0.4 * np.sin(7 * at)
    box = np.array([[-1, -1, -1], [1, 1, 1]], dtype=np.float32)
    np.savez(folder / "ball.npz", density=density.astype("f4"), color=color.astype("f4"), box=box)
    return Scene(folder, "ball.npz", f"--cameras {cameras(folder)}", COMMON)


def cameras(folder):
    """Six cameras around the origin."""
    import json

    frames = []
    for k in range(6):
        turn = 2 * np.pi * k / 6
        back = np.array([np.cos(turn), np.sin(turn), 0.4 * (-1) ** k])
        back /= np.linalg.norm(back)
        right = np.cross([0, 0, 1], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(back, right), back])
        pose[:3, 3] = 2.6 * back
        frames.append({"file_path": f"r_{k}", "transform_matrix": pose.tolist()})
    (folder / "cameras.json").write_text(json.dumps({"camera_angle_x": 0.8, "w": 200, "h": 160, "frames": frames}))
    return "cameras.json"


def splats(folder):
    """Discs on a bumpy ball with colours that depend on the direction; six cameras see all but the inner ball."""
    count, inner = 4000, 600
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = 2.399963 * k
    normal = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    radius = 0.6 + 0.05 * np.sin(9 * normal).prod(axis=1)
    radius[:: count // inner] = 0.25
    # The rotation that takes z to the normal.
    rotation = np.column_stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)])
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    noise = np.random.default_rng(1)
    columns = {}
    for axis, name in enumerate("xyz"):
        columns[name] = radius * normal[:, axis]
    for channel in range(3):
        columns[f"f_dc_{channel}"] = 1.2 * np.sin(5 * normal[:, channel])
    for entry in range(9):
        columns[f"f_rest_{entry}"] = 0.03 * noise.standard_normal(count)
    columns["opacity"] = noise.uniform(1, 5, count)
    for axis, size in enumerate((0.04, 0.03, 0.006)):
        columns[f"scale_{axis}"] = np.full(count, np.log(size))
    for entry in range(4):
        columns[f"rot_{entry}"] = rotation[:, entry]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in columns] + ["end_header", ""]
    rows = np.column_stack(list(columns.values())).astype("<f4")
    (folder / "ball.ply").write_bytes("\n".join(header).encode() + rows.tobytes())
    scene = SplatsScene(folder, "ball.ply", f"--cameras {cameras(folder)}", COMMON)
    # Splats are drawn as `render` draws them; only colours do not depend on the direction.
    scene.within, scene.median, scene.color, scene.cut, scene.pointer = 0.99, 0.01, 30, 30, 0.01
    return scene


def contracted(folder):
    """All of space, with a part that is not contracted smaller than the scene."""
    options = "--resolution 200"
    return Scene(folder, "scene:courtyard", options, f"{COMMON} --contract l2:0,0,0,0.7")


@pytest.fixture(scope="module", params=[lego, voxels, contracted, splats], ids=lambda make: make.__name__)
def scene(request, tmp_path_factory):
    return request.param(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def page(scene, browser):
    page = Page(browser, scene.html)
    assert page.said == "ready", page.said
    page.camera(1)
    return page


def hide_unseen(page, wanted):
    page.do("const b = document.getElementById('hide-unseen'); if (b.checked !== arguments[0]) b.click()", wanted)


def psnr(a, b):
    return -10 * np.log10(((a - b) ** 2).mean())


def test_it_opens_from_disk_without_a_word(scene, page):
    assert scene.html.stat().st_size <= 6e6
    assert page.console() == []
    assert page.do("return performance.getEntriesByType('resource').length") == 0, "it asks nobody"


def test_pictures_are_those_of_render(scene, page):
    page.threshold(99)
    page.layer("color")
    color, opacity, depth, log10 = scene.rendered(1)
    assert (opacity > 0.5).mean() > 0.05
    assert psnr(page.picture(), color) >= scene.color
    found = page.numbers()
    matter = (opacity > 0.5) & (found[..., 0] > 0.5)
    assert matter.sum() > 0.95 * (opacity > 0.5).sum()
    off = np.abs(found[..., 2] - log10)[matter]
    share, median = (off <= 0.1).mean(), np.median(off)
    print(f"log10 U: {share:.3f} of the pixels within 0.1, median error {median:.3f}")
    assert share >= scene.within and median <= scene.median, np.quantile(off, [0.5, 0.8, 0.9, 0.95])
    # Half of a cell and what density is blurred by; splats are as deep as in `render`.
    apart = page.do("return v.about.grid ? 4 * v.about.grid.edge : 1e-4")
    assert np.quantile(np.abs(found[..., 1] - depth)[matter], 0.9) < apart


def test_the_slider_removes_what_render_removes(scene, page):
    low, prior = page.do("return [v.about.range[0], v.about.prior]")
    bars = np.array(page.do("return v.about.histogram"))
    # Where two thirds of the visible surfaces stay.
    kept = np.searchsorted(np.cumsum(bars), 0.66 * bars.sum()) + 1
    threshold = low + kept / len(bars) * (prior - low)
    page.do(
        "document.getElementById('threshold').value = arguments[0]; "
        "document.getElementById('threshold').dispatchEvent(new Event('input'))",
        threshold,
    )
    threshold = page.do("return v.shown.threshold")
    # Both remove what was never seen, too.
    page.layer("color")
    color, opacity, _, _ = scene.rendered(1, f"--threshold={threshold}")
    whole, _, _, _ = scene.rendered(1)
    found = page.numbers()[..., 0] > 0.5
    same = (found == (opacity > 0.5)).mean()
    assert same > 0.97, same
    assert psnr(page.picture(), color) >= scene.cut
    # It did remove something.
    assert psnr(whole, color) < 40
    page.threshold(99)


def words(page, name):
    return page.do("v.draw(); return document.getElementById(arguments[0]).textContent", name)


def test_the_slider_s_last_position_removes_nothing_and_the_one_before_only_what_was_seen(scene, page):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    slider = page.driver.find_element(By.ID, "threshold")
    prior = page.do("return v.about.prior")
    page.threshold(99)
    whole = page.numbers()[..., :2]
    slider.send_keys(Keys.END)
    assert words(page, "threshold-words") == "the slider removes nothing"
    assert "0.0 % is removed" in words(page, "unseen-words")
    assert np.array_equal(page.numbers()[..., :2], whole)
    slider.send_keys(Keys.ARROW_LEFT)
    threshold = page.do("return v.shown.threshold")
    assert prior - 0.02 < threshold < prior
    # What was never seen is most of the matter inside of things, and goes.
    gone, unseen = shares_of_matter(page)
    assert unseen > 5 and unseen <= gone < 1.5 * unseen, (gone, unseen)
    box = "const b = document.getElementById('hide-unseen'); return [b.checked, b.disabled]"
    assert page.do(box) == [True, True]
    slider.send_keys(Keys.ARROW_RIGHT)
    assert words(page, "threshold-words") == "the slider removes nothing"
    assert page.do(box) == [False, False]
    assert np.array_equal(page.numbers()[..., :2], whole)
    page.threshold(99)


def test_the_slider_reveals_nothing_that_was_never_seen_and_its_words_are_true_of_the_picture(scene, page):
    page.camera(1)
    page.threshold(99)
    page.layer("uncertainty")
    page.do("v.shown.split = null")
    whole = page.numbers()
    low, prior = page.do("return [v.about.range[0], v.about.prior]")
    for part in (0.95, 0.75, 0.5):
        threshold = low + part * (prior - low)
        page.threshold(threshold)
        page.do("v.isMoving = false; v.draw()")
        text = words(page, "threshold-words")
        assert text.startswith(f"log10 U ≤ {threshold:.2f}: ") and text.endswith(" % of the surface in view stays")
        left = page.numbers()
        same = (left[..., 0] > 0.5) & (np.abs(left[..., 1] - whole[..., 1]) < 0.01 * whole[..., 1])
        share = 100 * same[whole[..., 0] > 0.5].mean()
        assert abs(float(text.split(": ")[1].split()[0]) - share) < 2, (text, share)
        hatched = (np.abs(page.picture() - 150 / 255) < 1e-3).all(axis=-1)
        assert hatched.mean() < 1e-3, (threshold, hatched.sum())
    page.do("v.shown.split = 0.5")
    page.threshold(99)


def shares_of_matter(page):
    """Per cent of all matter that is removed, and that was never seen, as the panel says."""
    return [float(part.split()[-1]) for part in words(page, "unseen-words").split(" %")[:2]]


def test_never_seen_matter_goes_by_its_own_switch(scene, page):
    page.threshold(99)
    page.camera(1)
    # From somewhere behind the surface that it looks at, the camera sees something that no ray reached.
    for forward in (1.06, 1.02, 1.12, 1.2, 1.3, 0.95, 1.45, 1.6):
        page.camera(1)
        page.do("v.camera.move(0, 0, arguments[0]); v.draw()", forward)
        whole = page.numbers()[..., :2]
        assert shares_of_matter(page)[0] == 0
        hide_unseen(page, True)
        gone, unseen = shares_of_matter(page)
        assert gone == unseen > 5
        if (page.numbers()[..., :2] != whole).any(axis=-1).mean() > 0.05:
            break
        hide_unseen(page, False)
    else:
        raise AssertionError("nothing that was never seen is in view, wherever the camera stands")
    # The key does the same as the switch.
    press(page, "h")
    assert np.array_equal(page.numbers()[..., :2], whole)
    assert not page.do("return document.getElementById('hide-unseen').checked")
    page.camera(1)


def press(page, keys):
    from selenium.webdriver import ActionChains

    ActionChains(page.driver).send_keys(keys).perform()


def test_it_opens_on_uncertainty_beside_colour(scene, page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    page = Page(page.driver, scene.html)
    assert page.do("return [v.shown.layer, v.shown.split]") == ["uncertainty", 0.5]
    page.camera(1)
    both = page.picture()
    page.layer("color")
    color = page.picture()
    page.do("document.getElementById('split').click()")
    page.layer("uncertainty")
    uncertainty = page.picture()
    middle = page.size[0] // 2
    assert np.array_equal(both[:, :middle], color[:, :middle])
    assert np.array_equal(both[:, middle + 1 :], uncertainty[:, middle + 1 :])
    assert not page.driver.find_element(By.ID, "divider").is_displayed()
    # The key brings the divider back, and it can be dragged.
    press(page, "v")
    page.do("v.draw()")
    divider, area = (page.driver.find_element(By.ID, name) for name in ("divider", "area"))
    before = page.do("return v.camera.position")
    ActionChains(page.driver).drag_and_drop_by_offset(divider, -area.size["width"] // 4, 0).perform()
    assert abs(page.do("return v.shown.split") - 0.25) < 0.02
    assert page.do("return v.camera.position") == before, "the camera stays where it is"


def test_the_slider_has_ticks_and_words(scene, page):
    ticks = page.do("return [...document.querySelectorAll('#ticks span')].map((t) => Number(t.textContent))")
    low, high = page.do("const s = document.getElementById('threshold'); return [Number(s.min), Number(s.max)]")
    assert 3 <= len(ticks) <= 7 and ticks == sorted(ticks) and low <= ticks[0] and ticks[-1] <= high
    assert words(page, "threshold-unit") == page.do("return v.about.quantity")
    # The middle of the thumb stands over the number.
    places = page.do(
        "return [...document.querySelectorAll('#ticks span')].map((t) => t.getBoundingClientRect())"
        ".map((r) => r.x + r.width / 2)"
    )
    left, width = page.do(
        "const r = document.getElementById('threshold').getBoundingClientRect(); return [r.x, r.width]"
    )
    expected = [left + 8 + (tick - low) / (high - low) * (width - 16) for tick in ticks]
    assert np.allclose(places, expected, atol=1.5)


def test_the_pointer_reads_what_query_or_render_says(scene, page):
    page.threshold(99)
    width, height = page.size
    fractions = np.linspace(0.3, 0.7, 7)
    places = [(int(x * width) + 0.5, int(y * height) + 0.5) for x in fractions for y in fractions]
    found = [(place, page.do("return v.read(...arguments[0])", place)) for place in places]
    found = [(place, reading) for place, reading in found if reading and "log10U" in reading]
    assert len(found) > 10
    places, readings = zip(*found, strict=True)
    off = np.abs(np.array([reading["log10U"] for reading in readings]) - scene.answers(places, readings))
    assert np.quantile(off, 0.8) <= scene.pointer, np.sort(off)


def test_mouse_keys_and_buttons_move_the_camera(page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    page.camera(0)
    area = page.driver.find_element(By.ID, "area")
    position = lambda: np.array(page.do("return v.camera.position"))
    target = lambda: np.array(page.do("return v.camera.target()"))
    before, center = position(), target()
    ActionChains(page.driver).drag_and_drop_by_offset(area, 80, 30).perform()
    assert np.linalg.norm(position() - before) > 0.1 * np.linalg.norm(before - center)
    assert np.allclose(target(), center, atol=1e-6), "it turns about what it looks at"
    distance = np.linalg.norm(position() - center)
    ActionChains(page.driver).send_keys("+").perform()
    assert np.isclose(np.linalg.norm(position() - center), 0.9 * distance)
    ActionChains(page.driver).send_keys(Keys.ARROW_LEFT).send_keys("3").perform()
    assert page.do("return v.shown.layer") == "uncertainty"
    page.driver.find_element(By.ID, "next").click()
    assert page.do("return v.current") == 1
    assert np.allclose(position(), page.do("return v.about.cameras[1].position"))
    page.driver.find_element(By.ID, "frusta").click()
    page.do("v.camera.zoom(4); v.draw()")
    drawn = page.do(
        "return v.overlay.getContext('2d').getImageData(0, 0, v.overlay.width, v.overlay.height).data"
        ".some((n) => n > 0)"
    )
    assert drawn, "frusta are drawn"
    page.driver.find_element(By.ID, "frusta").click()
    assert page.console() == []


def test_the_horizon_stays_level_until_it_is_released(page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    page.camera(0)
    area = page.driver.find_element(By.ID, "area")
    tilt = lambda: abs(page.do("return v.camera.up.reduce((sum, n, k) => sum + n * v.camera.axes[k], 0)"))
    drag = lambda x, y: ActionChains(page.driver).drag_and_drop_by_offset(area, x, y).perform()
    for way in [(150, 60), (-90, 80), (120, -200), (0, 250)]:
        drag(*way)
        assert tilt() < 1e-6, way
    press(page, "u")
    for way in [(150, 60), (-90, 80), (120, -100)]:
        drag(*way)
    assert tilt() > 0.05
    press(page, "u")
    assert tilt() < 1e-6, "it is level at once"


def test_up_is_what_the_cameras_right_axes_agree_on(page):
    up, axes = page.do("return [v.camera.up, v.about.cameras.map((camera) => camera.axes)]")
    axes = np.array(axes).reshape(-1, 3, 3)
    assert np.abs(axes[:, 0] @ up).max() < 1e-5 and (axes[:, 1] @ up).mean() > 0.5


def test_a_click_on_a_frustum_flies_there_and_a_double_click_looks_at_a_point(page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    page.camera(0)
    page.do("v.frame(); v.camera.zoom(2); document.getElementById('frusta').click(); v.draw()")
    area = page.driver.find_element(By.ID, "area")
    apex = """
        const [w, h] = v.fixed ?? v.size();
        const shown = v.allFrusta(w, h).map((f) => f && f[0].map((n, k) => n / [w, h][k]));
        const far = (a, b) => !b || Math.hypot(a[0] - b[0], a[1] - b[1]) > 0.03;
        const k = shown.findIndex((a, i) => i > 0 && a && a.every((n) => n > 0.05 && n < 0.95) &&
          shown.every((b, j) => i === j || far(a, b)));
        return [k, ...(shown[k] ?? [])];"""
    k, x, y = page.do(apex)
    size = area.size
    offset = int((x - 0.5) * size["width"]), int((y - 0.5) * size["height"])
    ActionChains(page.driver).move_to_element_with_offset(area, *offset).click().perform()
    assert page.do("return v.current") == k
    arrived = "return Math.hypot(...v.camera.position.map((n, i) => n - v.about.cameras[v.current].position[i])) < 1e-9"
    wait(page, arrived)
    assert f"{k}: " in words(page, "camera-name")
    page.do("document.getElementById('frusta').click()")
    # Something beside the middle comes to the middle, and is as far away as it was.
    page.camera(1)
    wanted = page.do(
        "const [w, h] = v.camera.resolution; const at = [0.4, 0.45, 0.5, 0.55, 0.6].flatMap((x) => "
        "[0.4, 0.5, 0.6].map((y) => [x * w, y * h]))"
        ".find(([x, y]) => Math.hypot(x - w / 2, y - h / 2) > 5 && v.read(x, y));"
        "const found = v.read(...at); v.focus(...at); return [found.position, found.depth]"
    )
    assert np.allclose(page.do("return v.camera.target()"), wanted[0], atol=1e-5)
    assert np.isclose(page.do("return v.camera.distance"), wanted[1])
    page.camera(1)


def wait(page, condition):
    import time

    for _ in range(200):
        if page.do(condition):
            return
        time.sleep(0.05)
    raise AssertionError(condition)


def test_the_crop_box_cuts_and_is_drawn(page):
    page.camera(1)
    page.threshold(99)
    whole = page.numbers()[..., :2]
    press(page, "b")
    assert page.do("return document.getElementById('crop').open")
    page.do(
        "const s = document.getElementById('crop-x-min'); s.value = 0.5; s.dispatchEvent(new Event('input')); v.draw()"
    )
    cut = page.numbers()[..., 0]
    # What is left lies beyond the middle.
    middle = page.do("return v.model.anchor[0]")
    points = page.do(
        "const [w, h] = v.camera.resolution; return [0.3, 0.4, 0.5, 0.6, 0.7].flatMap((x) => [0.4, 0.5, 0.6]"
        ".map((y) => v.read(x * w, y * h))).filter((f) => f).map((f) => f.position[0])"
    )
    assert all(x > middle - 0.02 for x in points), points
    assert (cut < 0.5).sum() > (whole[..., 0] < 0.5).sum() + 100
    lines = (
        "const { width, height } = v.overlay; "
        "return v.overlay.getContext('2d').getImageData(0, 0, width, height).data.some((n) => n > 0)"
    )
    assert page.do(lines), "the box is drawn"
    page.do("document.getElementById('uncrop').click()")
    assert np.array_equal(page.numbers()[..., :2], whole)
    press(page, "b")
    page.do("v.draw()")
    assert not page.do(lines)


def test_a_picture_is_saved_as_it_is_shown(page):
    page.camera(1)
    page.layer("color")
    shown = page.picture()
    text = page.do("return v.picture()").split(",")[1]
    saved = np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")) / 255.0
    assert np.array_equal(saved, shown)
    link = page.do(
        "let link; const click = HTMLAnchorElement.prototype.click;"
        "HTMLAnchorElement.prototype.click = function () { link = [this.download, this.href.slice(0, 22)]; };"
        "document.getElementById('save').click(); HTMLAnchorElement.prototype.click = click; return link"
    )
    assert link[0].endswith("-color.png") and "/" not in link[0] and link[1] == "data:image/png;base64,"


def test_help_fits_into_800_pixels(page):
    before = page.driver.get_window_size()
    page.driver.set_window_size(800, 800)
    press(page, "?")
    fits = page.do(
        "const h = document.getElementById('help'), r = h.getBoundingClientRect();"
        "return h.open && r.left >= 0 && r.top >= 0 && r.right <= innerWidth && r.bottom <= innerHeight"
        " && h.scrollHeight <= h.clientHeight && h.scrollWidth <= h.clientWidth"
    )
    assert fits
    press(page, "?")
    assert not page.do("return document.getElementById('help').open")
    page.driver.set_window_size(before["width"], before["height"])


def test_long_names_of_cameras_wrap(page):
    page.do("v.about.cameras[1].name = 'folder_'.repeat(40); v.jump(1)")
    within = "const n = document.getElementById('camera-name'); return n.scrollWidth <= n.clientWidth"
    assert page.do(within)
    page.do("v.about.cameras[1].name = 'r_1'; v.jump(1)")


def test_tinted_keeps_the_colour_of_what_is_certain(page):
    page.camera(1)
    page.threshold(99)
    page.layer("color")
    color, numbers = page.picture(), page.numbers()
    page.layer("tinted")
    tinted = page.picture()
    low, high = page.do("return v.about.range")
    place = (numbers[..., 2] - low) / (high - low)
    certain, not_certain = (numbers[..., 0] > 0.9) & (place < 0.1), (numbers[..., 0] > 0.9) & (place > 0.6)
    assert certain.sum() > 20 and np.abs(tinted - color)[certain].max() < 0.02
    if not_certain.sum() > 20:
        assert np.abs(tinted - color)[not_certain].mean() > 0.05
    page.layer("color")


def test_without_webgl_it_says_so(scene, browser):
    browser.execute_cdp_cmd("Page.enable", {})
    broken = "HTMLCanvasElement.prototype.getContext = () => null"
    script = browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": broken})
    page = Page(browser, scene.html)
    browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)
    words = page.do("return document.getElementById('status').textContent")
    assert "WebGL2" in words and page.do("return !document.getElementById('status').hidden")


def test_a_lost_context_is_said_and_drawn_again(scene, browser):
    from selenium.webdriver.common.by import By

    page = Page(browser, scene.html)
    page.camera(1)
    page.layer("tinted")
    before = page.picture()
    page.do("window.lost = v.renderer.gl.getExtension('WEBGL_lose_context'); lost.loseContext()")
    wait(page, "return !document.getElementById('status').hidden")
    assert "graphics context" in page.do("return document.getElementById('status').textContent")
    # Whatever is touched meanwhile.
    page.do("v.draw(); v.camera.orbit(0.1, 0); v.moved(); v.layer('depth'); v.jump(0); v.read(10, 10); v.threshold(99)")
    page.do("lost.restoreContext()")
    wait(page, "return document.getElementById('status').hidden")
    page.camera(1)
    page.layer("tinted")
    assert np.array_equal(page.picture(), before)
    # A context that does not return: the page can be loaded again.
    page.do("v.renderer.gl.getExtension('WEBGL_lose_context').loseContext()")
    wait(page, "return !document.getElementById('status').hidden")
    page.driver.find_element(By.CSS_SELECTOR, "#status button").click()
    wait(page, "return window.lost === undefined && document.getElementById('status').hidden")
    browser.get_log("browser")


def test_frames_come_fast_enough_to_turn(scene, page, record_property):
    """The picture gets smaller while it moves, until it comes ten times a second."""
    page = Page(page.driver, scene.html)
    page.do("v.fixed = [400, 400]; v.layer('color'); v.draw()")
    whole = np.median([page.do("return v.draw()") for _ in range(5)])
    page.do("v.isMoving = true")
    for _ in range(12):
        took = page.do("v.camera.orbit(0.02, 0); return v.draw(v.shrink)")
    took = np.median([page.do("v.camera.orbit(0.02, 0); return v.draw(v.shrink)") for _ in range(7)])
    reads = page.do(
        "const n = v.renderer.measure(v.camera, v.shown, 400, 400); let s = 0; "
        "for (let i = 3; i < n.length; i += 4) s += n[i]; return s / 160000"
    )
    print(f"400 x 400: {whole:.0f} ms at rest, {took:.0f} ms while it moves, {reads:.1f} texture reads a pixel")
    assert took < 200, "on a shared machine; 80 ms are aimed at"
