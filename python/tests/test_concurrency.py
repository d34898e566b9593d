"""Exceptions, Ctrl-C, threads: nothing hangs, nothing is half-written. What might hang runs in a process of its own."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
import traceback

import pytest
from conftest import SMALL, in_python

import octobayes as ob

#: Longest time that a test's process may take; a deadlock takes longer.
PATIENCE = 120


class Unwell(Exception):
    """What a callable of a user raises."""


def raise_unwell(depth: int) -> None:
    if depth:
        raise_unwell(depth - 1)
    raise Unwell("out of memory, say")


@pytest.mark.parametrize("when", [0, 1, 40])
@pytest.mark.parametrize("where", ["call", "density", "derivatives"])
def test_the_callables_exception_comes_out_with_its_traceback(when, where, courtyard, cameras, tmp_path):
    calls = []
    raised = []

    def failing(*arguments):
        calls.append(len(arguments[0]))
        if len(calls) > when:
            try:
                raise_unwell(2)
            except Unwell as error:
                raised.append(error)
                raise
        if where == "density":
            return courtyard.density(*arguments)
        density, color = courtyard(*arguments)
        return density, color, 0 * color, 0 * color[:, :, None].repeat(3, 2)

    f = in_python(courtyard, "step")
    if where == "call":
        f = lambda x, d: failing(x, d)[:2]
    else:
        setattr(f, where, failing)
    with pytest.raises(Unwell) as caught:
        ob.uncertainty(
            f, cameras, box=courtyard.box, batch=1 << 12, dump_samples=tmp_path / "samples.npz",
            checkpoint=None, gradient="auto", **SMALL,
        )  # fmt: skip
    assert len(raised) == 1 and caught.value is raised[0], "asked again after it raised"
    names = [frame.name for frame in traceback.extract_tb(caught.value.__traceback__)]
    assert names.count("raise_unwell") == 3 and "failing" in names
    assert list(tmp_path.iterdir()) == []


def test_exceptions_of_a_render_come_out(courtyard, cameras, field):
    def failing(x, d):
        raise_unwell(0)

    with pytest.raises(Unwell):
        ob.render(failing, field, cameras[0], progress=False)


def test_exceptions_of_the_progress_callback_come_out(courtyard, cameras):
    def failing(stage, done, total):
        raise_unwell(0)

    with pytest.raises(Unwell):
        ob.uncertainty(courtyard, cameras, **{**SMALL, "rays": 10**7, "progress": failing})


def test_other_threads_of_python_run_meanwhile(courtyard, cameras):
    ticks, over = [], threading.Event()

    def tick():
        while not over.wait(0.005):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    ob.uncertainty(courtyard, cameras, **{**SMALL, "rays": 60_000})
    end = time.monotonic()
    over.set()
    thread.join()
    gaps = [b - a for a, b in zip([start, *ticks], [*ticks, end])]
    # With the lock held there would be no tick at all.
    assert max(gaps) < 0.5 * (end - start), (max(gaps), end - start)


def run(code: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=PATIENCE, check=False
    )


def test_many_threads_that_call_back_do_not_deadlock():
    # Each run waits for Python, which waits for the pool that evaluates the model: two runs per processor, and more
    # threads that use the same pool all the time.
    code = """
        import os, threading
        from concurrent.futures import ThreadPoolExecutor
        import numpy as np, octobayes as ob

        model = ob.open_model("scene:courtyard")
        cameras = model.cameras(resolution=(48, 48))
        x = np.random.default_rng(0).uniform(-1, 1, (100_000, 3)).astype(np.float32)
        over = threading.Event()

        def busy():
            while not over.is_set():
                model(x, x)

        def nerf(x, d):
            return model(x, d)

        nerf.step = model.step
        others = [threading.Thread(target=busy) for _ in range(3)]
        [thread.start() for thread in others]

        def work(i):
            f = nerf if i % 2 else model
            return ob.uncertainty(f, cameras, box=model.box, level=5, rays=4_096, occupancy=32, batch=1 << 12)

        count = 2 * (os.cpu_count() or 2) + 2
        with ThreadPoolExecutor(count) as pool:
            fields = list(pool.map(work, range(count)))
        over.set()
        [thread.join() for thread in others]
        assert all(np.array_equal(fields[i].query(x), fields[i % 2].query(x)) for i in range(count))
        print("all", count)
    """
    done = run(code)
    assert done.stdout.startswith("all"), done.stderr


def test_a_callable_may_use_the_package_itself():
    code = """
        import octobayes as ob
        model = ob.open_model("scene:ball")
        small = dict(level=4, rays=1_024, occupancy=16)
        inside = []

        def nerf(x, d):
            if not inside:
                inside.append(ob.uncertainty(model, model.cameras(resolution=(16, 16)), **small))
            return model(x, d)

        u = ob.uncertainty(nerf, model.cameras(resolution=(16, 16)), box=model.box, **small)
        print("both", len(inside))
    """
    done = run(code)
    assert done.stdout == "both 1\n", done.stderr


LONG_RUNS = {
    "a callable": "ob.uncertainty(nerf, cameras, box=model.box, **forever)",
    "a model": "ob.uncertainty(model, cameras, **forever)",
    "a slow callable": "ob.uncertainty(slow, cameras, box=model.box, **forever)",
    "a picture": "ob.render(model, None, {'pose': cameras[0]['pose'], 'fov': 20, 'size': (1600, 1600)}, **told)",
    "samples": "ob.uncertainty(model, cameras, dump_samples='samples.npz', **forever)",
}


@pytest.mark.skipif(os.name == "nt", reason="signals as on Unix")
@pytest.mark.parametrize("what", LONG_RUNS)
def test_ctrl_c_stops_within_a_second(what, tmp_path):
    code = f"""
        import signal, sys, time
        import octobayes as ob

        # Shells start jobs in the background with this signal ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        model = ob.open_model("scene:courtyard")
        cameras = model.cameras(resolution=(48, 48))

        def nerf(x, d):
            return model(x, d)

        def slow(x, d):
            for _ in range(10):
                time.sleep(0.02)
            return model(x, d)

        nerf.step = slow.step = model.step

        def tell(stage, done, total):
            if done > 0:
                print("under way", flush=True)

        told = dict(progress=tell)
        forever = dict(rays=10**9, level=6, occupancy=24, **told)
        try:
            {LONG_RUNS[what]}
        except KeyboardInterrupt:
            print("stopped", time.time(), flush=True)
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True, cwd=tmp_path
    )
    timer = threading.Timer(PATIENCE, process.kill)
    timer.start()
    try:
        assert process.stdout.readline() == "under way\n"
        time.sleep(0.3)
        start = time.time()
        process.send_signal(signal.SIGINT)
        lines = process.stdout.read().splitlines()
        process.wait()
    finally:
        timer.cancel()
    assert lines[-1].startswith("stopped"), lines[-3:]
    assert float(lines[-1].split()[1]) - start < 1.0
    assert list(tmp_path.iterdir()) == []
