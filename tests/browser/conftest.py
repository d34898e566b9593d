"""Headless Chromium with software GL, and the binary named by OCTOBAYES at work in a folder."""

import base64
import io
import os
import subprocess
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

BINARY = os.environ.get("OCTOBAYES", "octobayes")
DRIVER = os.environ.get("CHROMEDRIVER", "/usr/bin/chromedriver")
DATA = os.environ.get("OCTOBAYES_DATA")


def run(folder, line):
    done = subprocess.run([BINARY, *line.split()], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, f"{line}: {done.stderr}"
    return done.stdout


@pytest.fixture(scope="session")
def browser():
    options = webdriver.ChromeOptions()
    software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    for argument in ["--headless=new", "--no-sandbox", "--window-size=1000,700", *software]:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.set_script_timeout(300)
    yield driver
    driver.quit()


class Page:
    """A viewer in the browser, opened from disk, with pictures as large as the training images."""

    def __init__(self, driver, path):
        self.driver = driver
        driver.get(Path(path).as_uri())
        self.said = driver.execute_async_script(
            "const done = arguments[0]; octobayes.then((o) => { window.v = o; done('ready'); }, (e) => done(e + ''));"
        )

    def do(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def camera(self, k):
        size = self.do("v.fixed = v.about.cameras[arguments[0]].resolution; v.jump(arguments[0]); return v.fixed", k)
        self.size = tuple(size)

    def layer(self, name):
        self.do("v.layer(arguments[0])", name)

    def threshold(self, log10):
        self.do("v.threshold(arguments[0])", log10)

    def picture(self):
        """The canvas, RGB in [0, 1]."""
        self.do("v.draw()")
        text = self.do("return v.canvas.toDataURL()").split(",")[1]
        image = Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")
        assert image.size == self.size
        return np.asarray(image) / 255.0

    def numbers(self):
        """Opacity, depth, log10 U and the cost of every pixel: texture reads of a volume, or splats."""
        script = """
            const bits = v.renderer.measure(v.camera, v.shown, ...arguments[0]);
            const bytes = new Uint8Array(bits.buffer);
            let text = '';
            for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
            return btoa(text);"""
        found = np.frombuffer(base64.b64decode(self.do(script, self.size)), dtype="<f4")
        return found.reshape(self.size[1], self.size[0], 4)

    def console(self):
        """What the console says, but for remarks on speed: the driver's, and the browser's on what tests read back."""
        speed = ("Performance", "Multiple readback operations")
        return [line for line in self.driver.get_log("browser") if not any(word in line["message"] for word in speed)]


class Scene:
    """A model, its field and its viewer."""

    # The share of the pixels whose log10 U is to be within 0.1 of what `render` says, and the largest median error.
    within, median = 0.95, 0.08
    # The least PSNR of colours, whole and with the slider in use.
    color, cut = 28, 24
    # The largest error of log10 U under the pointer, at 80 % of the places.
    pointer = 0.15

    def __init__(self, folder, model, options, arguments=""):
        self.folder, self.model = folder, model
        self.options = options
        run(folder, f"uncertainty {model} {options} {arguments} -o field.oct")
        self.said = run(folder, f"view {model} field.oct {options} -o view.html")
        self.html = folder / "view.html"

    def rendered(self, frame, more=""):
        """Channels of `render`: colour, opacity, depth, log10 U."""
        run(self.folder, f"render {self.model} field.oct {self.options} --frame {frame} {more} -o view.exr")
        channels = OpenEXR.File(str(self.folder / "view.exr")).channels()
        color = channels["RGBA"].pixels
        return (
            color[..., :3].clip(0, 1),
            color[..., 3],
            channels["depth.Z"].pixels,
            channels["log10_uncertainty.U"].pixels,
        )

    def query(self, points):
        np.save(self.folder / "points.npy", np.asarray(points, dtype=np.float32))
        run(self.folder, "query field.oct points.npy -o answers.csv")
        return np.genfromtxt(self.folder / "answers.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")

    def answers(self, places, readings):
        """log10 U at the points that the pointer read at image points of the second camera."""
        return self.query([reading["position"] for reading in readings])["log10_uncertainty"]


class SplatsScene(Scene):
    """Splats, whose pixels show a mean over centres that lie beside the ray."""

    def answers(self, places, readings):
        _, opacity, depth, log10 = self.rendered(1)
        rows, columns = (np.array([int(place[k]) for place in places]) for k in (1, 0))
        deep = np.array([reading["depth"] for reading in readings])
        # Where two splats have nearly half of the weight in front of them, rounding decides between them.
        assert np.quantile(np.abs(deep - depth[rows, columns]), 0.7) < 1e-4
        opaque = np.array([float(reading["more"][0].split()[1].rstrip(",")) for reading in readings])
        assert np.abs(opaque - opacity[rows, columns]).max() < 0.02
        return log10[rows, columns]
