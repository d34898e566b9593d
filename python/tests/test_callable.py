"""What a callable has to return: the same that a model's file has to hold, or a sentence that names what is wrong."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import octobayes as ob

SPACE = {"box": ([-1, -1, -1], [1, 1, 1]), "level": 5, "rays": 4_096, "occupancy": 32, "progress": False}


def look_at(eye):
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back, eye])


CAMERAS = [
    {"pose": look_at(3 * np.array([np.cos(a), np.sin(a), 0.2])), "fov": 40, "size": (32, 32)}
    for a in np.linspace(-1.2, 1.2, 4)
]
X = np.random.default_rng(2).uniform(-1, 1, (2000, 3)).astype(np.float32)


def ball(x):
    """Density of a soft ball, with its derivative."""
    radius = np.linalg.norm(x, axis=1)
    tail = 1 / (1 + np.exp(50 * (radius - 0.5)))
    return 80 * tail, (-80 * 50 * tail * (1 - tail) / np.maximum(radius, 1e-9))[:, None] * x


def waves(x, amplitude):
    """Colours around 1/2, with their derivatives."""
    return 0.5 + amplitude * np.sin(9 * x), np.eye(3) * (9 * amplitude * np.cos(9 * x))[:, :, None]


class Nerf:
    """The ball with waves, as ``change`` alters what it returns: density, colour and their derivatives."""

    def __init__(self, change=lambda *parts: parts, amplitude=0.4):
        self.change, self.amplitude = change, amplitude

    def __call__(self, x, d):
        return self.change(ball(x)[0], waves(x, self.amplitude)[0])[:2]


class Differentiable(Nerf):
    """The same, with derivatives of its own."""

    def derivatives(self, x, d):
        (density, slope), (color, color_gradient) = ball(x), waves(x, self.amplitude)
        changed = self.change(density, color, slope, color_gradient)
        return changed if len(changed) == 4 else (*changed, slope, color_gradient)


JOBS = {
    "uncertainty": lambda f, field, path: ob.uncertainty(f, CAMERAS, **SPACE),
    "forward": lambda f, field, path: ob.uncertainty(f, CAMERAS, gradient="forward-difference", **SPACE),
    "render": lambda f, field, path: ob.render(f, field, CAMERAS[0], progress=False),
    "mesh": lambda f, field, path: ob.export(field, path / "mesh.ply", f, mesh=True, cells=16, progress=False),
    "points": lambda f, field, path: ob.export(field, path / "u.ply", f, CAMERAS, pixels=900, progress=False),
    "executor": lambda f, field, path: ob.uncertainty(f, CAMERAS, executor=ThreadPoolExecutor(1), shards=2, **SPACE),
}


@pytest.fixture(scope="module")
def u():
    return ob.uncertainty(Nerf(), CAMERAS, **SPACE)


COLORS = {
    "0..255": (lambda s, c, *_: (s, 255 * c), r"expected values from 0 to 1, found 2\d\d(\.\d+)? at \[\d+, [012]\]"),
    "-1..1": (lambda s, c, *_: (s, 2 * c - 1), r"expected values from 0 to 1, found -0\.\d+ at \[\d+, [012]\]"),
    "a little too bright": (lambda s, c, *_: (s, c + 0.16), r"expected values from 0 to 1, found 1\.0\d+ at \["),
    "uint8": (
        lambda s, c, *_: (s, (255 * c).astype("u1")),
        r"expected values from 0 to 1, found integers of type uint8",
    ),
    "int64": (lambda s, c, *_: (s, np.rint(c).astype(np.int64)), r"found integers of type int64, up to 1"),
    "a tuple of channels": (lambda s, c, *_: (s, tuple(c.T)), r"shape \[\d+, 3\], found an array of shape \[3, \d+\]"),
    "alpha": (lambda s, c, *_: (s, np.c_[c, s]), r"expected an array of real numbers of shape \[\d+, 3\], found"),
}


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("what", COLORS)
def test_colors_of_another_scale_are_refused(what, job, u, tmp_path):
    change, sentence = COLORS[what]
    with pytest.raises(ValueError, match=f"^color, the second result of nerf: .*{sentence}"):
        JOBS[job](Nerf(change), u, tmp_path)
    assert list(tmp_path.iterdir()) == []


DENSITIES = {
    "without its activation": (lambda s, c, *_: (s - 3.25, c), r"found -3\.25 at \[\d+\]"),
    "a logarithm": (lambda s, c, *_: (np.log(s), c), r"found -\d+(\.\d+)? at \[\d+\]"),
    "a logarithm of nothing": (lambda s, c, *_: (np.log(np.where(s < 1, 0, s + 1)), c), r"found -inf at \[\d+\]"),
    "in a column": (lambda s, c, *_: (s[:, None] - 3.25, c), r"found -3\.25 at \[\d+\]"),
}


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("what", DENSITIES)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_negative_densities_are_named(what, job, u, tmp_path):
    change, sentence = DENSITIES[what]
    expected = "expected 0 or more .*activation.*"
    with pytest.raises(ValueError, match=f"^density, the first result of nerf: {expected}{sentence}"):
        JOBS[job](Nerf(change), u, tmp_path)


def test_every_result_is_checked():
    f = Nerf()
    f.density = lambda x: ball(x)[0] - 1
    with pytest.raises(ValueError, match=r"^the result of nerf.density: expected 0 or more .* found -1 at \[\d+\]"):
        ob.uncertainty(f, CAMERAS, **SPACE)
    analytic = {"gradient": "analytic", **SPACE}
    dark = lambda *parts: (parts[0] - (len(parts) == 4), *parts[1:])
    with pytest.raises(ValueError, match=r"^density, the first result of nerf.derivatives: expected 0 or more"):
        ob.uncertainty(Differentiable(dark), CAMERAS, **analytic)
    bright = lambda *parts: (parts[0], parts[1] * (255 if len(parts) == 4 else 1), *parts[2:])
    with pytest.raises(ValueError, match=r"^color, the second result of nerf.derivatives: expected values from 0 to 1"):
        ob.uncertainty(Differentiable(bright), CAMERAS, **analytic)


def test_what_is_not_a_number_drops_the_ray_as_before():
    def holed(x, d):
        density, color = Nerf()(x, d)
        return density, np.where(np.linalg.norm(x - [0.5, 0, 0], axis=1)[:, None] < 0.02, np.nan, color)

    with pytest.warns(RuntimeWarning, match=r"^\d+ rays dropped, the field is not finite"):
        ob.uncertainty(holed, CAMERAS, **SPACE)
    for change in (lambda s, c, *_: (s * np.nan, c), lambda s, c, *_: (s, c * np.inf)):
        with pytest.raises((FloatingPointError, ValueError), match=r"not finite|none: "):
            ob.uncertainty(Nerf(change), CAMERAS, **SPACE)


def clamped(density, color, *derivatives):
    """As a careful user returns it."""
    if not derivatives:
        return density, color.clip(0, 1)
    slope, color_gradient = derivatives
    return density, color.clip(0, 1), slope, np.where(((color < 0) | (color > 1))[:, :, None], 0, color_gradient)


@pytest.mark.parametrize("gradient", ["finite-difference", "forward-difference", "analytic"])
def test_a_small_overshoot_is_clamped_and_said_once(gradient):
    run = {**SPACE, "gradient": gradient}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        expected = ob.uncertainty(Differentiable(clamped, 0.54), CAMERAS, **run)
    with pytest.warns(RuntimeWarning) as caught:
        found = ob.uncertainty(Differentiable(amplitude=0.54), CAMERAS, **run)
    said = [str(warning.message) for warning in caught]
    assert said == ["colors of nerf exceed the range from 0 to 1 by up to 0.04; they were clamped to it"]
    assert caught[0].filename == __file__
    assert np.array_equal(found.query(X), expected.query(X))
    # The premise: clamping matters.
    assert not np.array_equal(found.query(X), ob.uncertainty(Nerf(), CAMERAS, **SPACE).query(X))


def test_a_small_overshoot_is_said_wherever_a_callable_is_asked(u, tmp_path):
    for name, job in JOBS.items():
        with pytest.warns(RuntimeWarning) as caught:
            job(Nerf(amplitude=0.54), u, tmp_path)
        # A mesh's few vertices need not be those of the largest overshoot.
        said = [str(warning.message) for warning in caught if "exceed the range" in str(warning.message)]
        assert len(said) == 1, (name, said)


def test_roundings_and_other_types_pass_without_a_word(u):
    run = {**SPACE, "rays": 512}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ob.uncertainty(Nerf(lambda s, c: (s, np.float32(c) + np.float32(0.1) + np.float32(1e-7))), CAMERAS, **run)
        plain = ob.uncertainty(Nerf(lambda s, c: (np.float32(s), np.float32(c))), CAMERAS, **run).query(X)
        for change in (
            lambda s, c: (s[:, None], c),
            lambda s, c: [s, c],
            lambda s, c: (np.float64(s), np.asfortranarray(c)),
            lambda s, c: (s.astype(object).astype(np.float32), c.tolist()),
        ):
            assert np.array_equal(ob.uncertainty(Nerf(change), CAMERAS, **run).query(X), plain)
        # A density of whole numbers is a density.
        ob.uncertainty(Nerf(lambda s, c: ((s > 40).astype(int) * 80, c)), CAMERAS, **{**run, "step": 0.1})


def test_tensors_that_record_gradients_are_checked_too():
    torch = pytest.importorskip("torch", reason="torch is not installed")

    def nerf(x, d):
        x = torch.from_numpy(x).requires_grad_(True)
        return 80 * torch.sigmoid(50 * (0.5 - x.norm(dim=1, keepdim=True))), scale * torch.sigmoid(9 * x)

    scale = 1
    ob.uncertainty(nerf, CAMERAS, **SPACE)
    scale = 255
    with pytest.raises(ValueError, match="color, the second result of nerf: expected values from 0 to 1, found"):
        ob.uncertainty(nerf, CAMERAS, **SPACE)


@pytest.mark.parametrize(
    ("background", "sentence"),
    [
        ([255, 255, 255], r"background: expected red, green and blue from 0 to 1, found \[255.0, 255.0, 255.0\]"),
        (np.uint8([200, 10, 0]), r"background: expected red, green and blue from 0 to 1, found"),
        ([-1, 0, 0], r"background: expected red, green and blue from 0 to 1, found"),
        ([0.5, np.nan, 0], r"background: expected finite numbers, found nan"),
        ("red", "background: expected 'white', 'black' or red, green and blue, found red"),
    ],
)
def test_backgrounds_of_another_scale_are_refused(background, sentence):
    f = Nerf()
    for arguments in ({"background": background}, {}):
        with pytest.raises(ValueError, match=sentence):
            ob.uncertainty(f, CAMERAS, **arguments, **SPACE)
        f.background = background
