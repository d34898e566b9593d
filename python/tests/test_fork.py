"""Processes that are started while, or after, the package was used: each gives the parent's answers. Each test is a
program of its own, because what fails waits for ever."""

import multiprocessing
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

#: Longest time that a child may take, seconds; one that waits for its parent's threads takes longer.
PATIENCE = 60

#: Every part of the package that computes, as functions of nothing. Each returns bytes that a child has to equal.
WORKSHOP = """
    import concurrent.futures, json, multiprocessing, os, pickle, signal, sys, tempfile, threading, time
    from pathlib import Path
    import numpy as np
    import octobayes as ob

    sys.path.insert(0, {tests!r})
    small = dict(level=5, rays=2048, occupancy=24, progress=False)
    x = np.random.default_rng(0).uniform(-1, 1, (5000, 3)).astype(np.float32)
    d = x / np.linalg.norm(x, axis=1)[:, None]

    class Workshop:
        def __init__(self):
            from conftest import exr, png

            self.folder = Path(tempfile.mkdtemp())
            self.model = model = ob.open_model("scene:courtyard")
            self.cameras = cameras = model.cameras(resolution=(24, 24))
            self.u = u = ob.uncertainty(model, cameras, keep_sums=True, **small)
            metric = ob.uncertainty(model, cameras, scale="data", noise=0.0316, keep_sums=True, **small)
            shards = [ob.uncertainty(model, cameras, shard=(i, 2), **small) for i in range(2)]
            rng = np.random.default_rng(1)
            samples = dict(
                positions=x, jacobian=rng.normal(size=(5000, 3, 3)), ray=np.sort(rng.integers(0, 99, 5000)),
                rays_total=100,
            )
            grid = dict(density=rng.uniform(0, 9, (8, 8, 8)), color=rng.uniform(0, 1, (8, 8, 8, 3)), box=model.box)
            np.savez(self.folder / "grid.npz", **{{name: part.astype("f4") for name, part in grid.items()}})
            voxels = ob.open_model(self.folder / "grid.npz")
            self.nerf = nerf = lambda a, b: model(a, b)
            nerf.step = model.step
            frames = []
            for i in range(2):
                view = ob.render(model, None, cameras[i], progress=False)
                png(self.folder / f"{{i}}.png", np.dstack([255 * view["color"].clip(0, 1), 255 * (view["depth"] > 0)]))
                # Some error, so that there is something to rank.
                exr(self.folder / f"{{i}}.exr", view["depth"] * (1 + 0.1 * rng.uniform(size=(24, 24))))
                frames.append({{"file_path": f"{{i}}.png", "transform_matrix": cameras[i]["pose"].tolist()}})
            lens = {{"fl_x": float(cameras[0]["focal"][0]), "w": 24, "h": 24}}
            (self.folder / "transforms_test.json").write_text(json.dumps({{**lens, "frames": frames}}))
            test = self.folder / "transforms_test.json"
            known = dict(depth=self.folder, depth_pattern="{{}}.exr", stride=1, progress=False)

            def written(name, *arguments, **options):
                ob.export(u, self.folder / name, *arguments, progress=False, **options)
                # The names of an archive's members are the same, the times are not.
                return dict(np.load(self.folder / name)) if name.endswith("npz") else (self.folder / name).read_bytes()

            def saved():
                u.save(self.folder / "field.oct")
                return ob.load(self.folder / "field.oct").query(x)

            self.parts = dict(
                query=lambda: u.query(x),
                log10=lambda: u.log10(x[0]),
                rays=lambda: u.rays(x),
                seen=lambda: u.seen(x),
                ray_coverage=lambda: u.ray_coverage_at(x),
                matrices=lambda: u.covariance(x),
                summary=lambda: u.summary,
                covariance=lambda: u.with_covariance("block").query(x),
                share=lambda: u.surface_quantile(0.5),
                save=saved,
                pickle=lambda: pickle.loads(pickle.dumps(u)).query(x),
                compare=lambda: ob.compare(u, metric),
                merge=lambda: ob.merge(shards).query(x),
                accumulate=lambda: ob.accumulate(samples, box=model.box, level=4).query(x),
                model=lambda: model(x, d),
                density=lambda: model.density(x),
                derivatives=lambda: voxels.derivatives(x, d),
                open=lambda: ob.open_model("scene:courtyard").density(x),
                npz=lambda: written("u.npz"),
                npy=lambda: written("u.npy"),
                htg=lambda: written("u.htg"),
                ply=lambda: written("u.ply", model, cameras, pixels=2000),
                mesh=lambda: written("m.ply", nerf, box=model.box, mesh=True, cells=16),
                render=lambda: ob.render(model, metric, cameras[0], depth_error=True, progress=False),
                callable=lambda: ob.render(nerf, u, cameras[0], progress=False),
                run=lambda: ob.uncertainty(model, cameras, **small).query(x),
                run_of_callable=lambda: ob.uncertainty(nerf, cameras, box=model.box, **small).query(x),
                evaluate=lambda: ob.evaluate(model, u, test, **known),
                calibrate=lambda: ob.calibrate(model, metric, test, **known)[1],
            )

        def answers(self):
            return {{name: repr(plain(part())) for name, part in self.parts.items()}}

    def plain(value):
        if isinstance(value, np.ndarray):
            return value.dtype.str, value.shape, value.tobytes()
        if isinstance(value, dict):
            return {{key: plain(part) for key, part in value.items()}}
        return [plain(part) for part in value] if isinstance(value, (tuple, list)) else value

    def check(found, expected):
        differing = [name for name in expected if found[name] != expected[name]]
        assert not differing and len(expected) > 20, differing

    def forked(work, *arguments):
        # A child that hangs ends by SIGALRM. (The watchdog of faulthandler does not survive fork().)
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                signal.alarm({patience})
                work(*arguments)
                code = 0
            except BaseException:
                sys.excepthook(*sys.exc_info())
            finally:
                sys.stdout.flush()
                os._exit(code)
        return pid

    def ended(pid):
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
"""

unix = pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork()")


def run(code: str, tmp_path: Path) -> str:
    """The output of a program that follows the workshop."""
    head = textwrap.dedent(WORKSHOP).format(tests=str(Path(__file__).parent), patience=PATIENCE)
    program = tmp_path / "program.py"
    program.write_text(head + textwrap.dedent(code))
    done = subprocess.run(
        [sys.executable, program], capture_output=True, text=True, timeout=4 * PATIENCE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


@unix
def test_a_child_of_a_process_that_used_the_package_gives_its_answers(tmp_path):
    code = """
        shop = Workshop()
        expected = shop.answers()
        check(shop.answers(), expected)

        def child(levels):
            check(shop.answers(), expected)
            # A child may have children.
            if levels:
                assert ended(forked(child, levels - 1)) == 0

        assert ended(forked(child, 1)) == 0
        # And the parent goes on.
        check(shop.answers(), expected)
        print("same")
    """
    assert run(code, tmp_path) == "same\n"


@unix
@pytest.mark.parametrize("busy", ["run", "run_of_callable", "query", "model", "merge"])
def test_a_child_of_a_process_in_the_middle_of_work_gives_its_answers(busy, tmp_path):
    code = f"""
        shop = Workshop()
        over, rounds = threading.Event(), [0, 0]

        def some():
            names = ("query", "seen", "compare", "model", "render", "run")
            return {{name: repr(plain(shop.parts[name]())) for name in names}}

        expected = some()

        def work(i):
            while not over.is_set():
                shop.parts[{busy!r}]()
                rounds[i] += 1

        threads = [threading.Thread(target=work, args=[i]) for i in range(2)]
        [thread.start() for thread in threads]
        for i in range(4):
            before = list(rounds)
            while min(rounds) == before[0]:
                time.sleep(0.01)
            time.sleep(0.003 * i)

            def child():
                assert some() == expected

            assert ended(forked(child)) == 0, i
        over.set()
        [thread.join() for thread in threads]
        print("same", min(rounds) > 0)
    """
    assert run(code, tmp_path) == "same True\n"


@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_workers_of_the_standard_library_give_the_same_answers(method, tmp_path):
    code = f"""
        def task(u, model):
            return u.log10(x), model(x, d)

        if __name__ == "__main__":
            shop = Workshop()
            expected = plain(task(shop.u, shop.model))
            context = multiprocessing.get_context({method!r})
            with context.Pool(2) as pool:
                found = pool.starmap_async(task, [(shop.u, shop.model)] * 3).get({PATIENCE})
            assert all(plain(one) == expected for one in found)
            with concurrent.futures.ProcessPoolExecutor(2, mp_context=context) as executor:
                futures = [executor.submit(task, shop.u, shop.model) for _ in range(3)]
                assert all(plain(future.result({PATIENCE})) == expected for future in futures)
                whole = ob.uncertainty("scene:courtyard", shop.cameras, executor=executor, shards=2, **small)
            np.testing.assert_allclose(whole.log10(x), shop.u.log10(x), atol=1e-6)
            print("same")
    """
    assert run(code, tmp_path) == "same\n"


@unix
@pytest.mark.parametrize("place", ["callable", "progress"])
@pytest.mark.parametrize("ends", ["by returning", "by an exception", "by sys.exit"])
def test_a_child_that_comes_back_into_its_parents_work_ends_at_once(place, ends, tmp_path):
    code = f"""
        model = ob.open_model("scene:ball")
        parent, children = os.getpid(), []

        def fork():
            if children or os.getpid() != parent:
                return
            children.append(os.fork())
            if children[0] == 0:
                signal.alarm({PATIENCE})
                if {ends!r} == "by an exception":
                    raise KeyError("of the child")
                if {ends!r} == "by sys.exit":
                    sys.exit(7)

        def nerf(a, b):
            if {place!r} == "callable":
                fork()
            return model(a, b)

        def tell(stage, done, total):
            if {place!r} == "progress":
                fork()

        cameras = model.cameras(resolution=(16, 16))
        u = ob.uncertainty(nerf, cameras, box=model.box, level=4, rays=20_000, occupancy=16, progress=tell)
        print("parent", u.record["rays"], "child", ended(children[0]))
    """
    head = textwrap.dedent(WORKSHOP).format(tests=str(Path(__file__).parent), patience=PATIENCE)
    done = subprocess.run(
        [sys.executable, "-c", head + textwrap.dedent(code)],
        capture_output=True, text=True, timeout=2 * PATIENCE, check=False,
    )  # fmt: skip
    status = 7 if ends == "by sys.exit" else 1
    assert (done.returncode, done.stdout) == (0, f"parent 20000 child {status}\n"), done.stdout + done.stderr
    said = {
        "by returning": ["RuntimeError: octobayes: expected", "spawn", "forkserver"],
        "by an exception": ["KeyError: 'of the child'"],
        "by sys.exit": [],
    }
    assert all(word in done.stderr for word in said[ends]), done.stderr
