"""Shards on executors: the same field as of one run, whoever computes them, and in whatever order."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import octobayes as ob
from octobayes import _shards

SMALL = {"level": 6, "rays": 16_384, "occupancy": 48, "progress": False}


def content(field: ob.Uncertainty, tmp_path) -> bytes:
    field.save(tmp_path / "field.oct")
    return (tmp_path / "field.oct").read_bytes()


class Backwards:
    """Runs what was submitted last first, in one thread, once all is there."""

    def __init__(self, shards: int) -> None:
        self.left, self.tasks = shards, []

    def submit(self, function, *arguments) -> Future:
        future: Future = Future()
        self.tasks.append((future, function, arguments))
        if len(self.tasks) == self.left:
            threading.Thread(target=self.work).start()
        return future

    def work(self) -> None:
        for future, function, arguments in reversed(self.tasks):
            future.set_result(function(*arguments))


class Slow:
    """A field in Python that another process can unpickle."""

    box, step, pixel_offset = [[-1.0] * 3, [1.0] * 3], 1 / 64, 0.5

    def __call__(self, x, d):
        density = np.where((x**2).sum(1) < 0.3, 50.0, 0.0)
        return density, np.clip(0.5 + x, 0, 1)


class Broken(Slow):
    def __call__(self, x, d):
        raise ArithmeticError("no such thing as light")


@pytest.fixture(scope="module")
def undisturbed(courtyard, cameras):
    with ThreadPoolExecutor(2) as executor:
        return ob.uncertainty(courtyard, cameras, executor=executor, shards=5, keep_sums=True, **SMALL)


def test_shards_are_the_whole_run(courtyard, cameras, field, undisturbed, points):
    assert undisturbed.record["rays"] == field.record["rays"]
    # 16,384 positive terms in another order; U is stored as f32.
    assert abs(undisturbed.log10(points) - field.log10(points)).max() < 1e-6
    assert (undisturbed.rays(points) == field.rays(points)).all()


def test_one_shard_is_the_run(courtyard, cameras, field, tmp_path):
    with ThreadPoolExecutor(1) as executor:
        alone = ob.uncertainty(courtyard, cameras, executor=executor, shards=1, keep_sums=True, **SMALL)
    assert content(alone, tmp_path) == content(field, tmp_path)


def test_order_and_processes_do_not_matter(courtyard, cameras, undisturbed, tmp_path):
    expected = content(undisturbed, tmp_path)
    settings = {"shards": 5, "keep_sums": True, **SMALL}
    backwards = ob.uncertainty(courtyard, cameras, executor=Backwards(5), **settings)
    assert content(backwards, tmp_path) == expected
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        calls = []
        settings["progress"] = lambda *call: calls.append(call)
        of_processes = ob.uncertainty(courtyard, cameras, executor=executor, **settings)
    assert content(of_processes, tmp_path) == expected
    assert calls == [("shards", i, 5) for i in range(1, 6)]


def test_sums_are_kept_only_if_wanted(courtyard, cameras, undisturbed, points):
    with ThreadPoolExecutor(1) as executor:
        slim = ob.uncertainty(courtyard, cameras, executor=executor, shards=2, **SMALL)
    assert undisturbed.keeps_sums and not slim.keeps_sums
    assert abs(slim.log10(points) - undisturbed.log10(points)).max() < 1e-6


def test_callables_travel_and_what_they_raise_comes_back(cameras, points):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        of_shards = ob.uncertainty(Slow(), cameras, executor=executor, shards=3, **SMALL)
        alone = ob.uncertainty(Slow(), cameras, **SMALL)
        assert abs(of_shards.log10(points) - alone.log10(points)).max() < 1e-6
        with pytest.raises(ArithmeticError, match="no such thing as light") as caught:
            ob.uncertainty(Broken(), cameras, executor=executor, shards=8, **SMALL)
    # Where it was raised, in the worker.
    assert "test_shards.py" in str(caught.value.__cause__)


def test_few_parts_wait(monkeypatch):
    merged = []

    def merge(pair, error_bars, keep_sums):
        merged.append(tuple(pair))
        return pair[0] + pair[1], []

    monkeypatch.setattr(_shards._octobayes, "merge", merge)
    for leaves in (2, 3, 7, 64, 100):
        tree, most = _shards.Tree(leaves), 0
        for index in range(leaves):
            whole = tree.add(index, [index])
            most = max(most, len(tree))
        assert whole == list(range(leaves)), "each once, in order"
        assert most <= leaves.bit_length()
    # Whatever comes first, the same two are merged.
    in_order = set(merged_by(range(7), merged))
    assert set(merged_by([5, 0, 6, 3, 2, 1, 4], merged)) == in_order


def merged_by(order, merged):
    merged.clear()
    tree = _shards.Tree(7)
    for index in order:
        tree.add(index, [index])
    return [tuple(map(tuple, pair)) for pair in merged]


def test_fields_pass_between_processes(field, points):
    again = pickle.loads(pickle.dumps(field))
    assert (again.query(points) == field.query(points)).all() and again.record == field.record


def test_wrong_arguments_get_a_sentence(courtyard, cameras):
    for arguments, sentence in (
        ({"shards": 4}, "shards: expected an executor beside them"),
        ({"executor": 3, "shards": 4}, "executor: expected a concurrent.futures.Executor"),
        ({"executor": Backwards(1)}, "shards: expected a whole number"),
        ({"executor": Backwards(1), "shards": 4, "shard": "0/2"}, "shard: expected None with an executor"),
        ({"executor": Backwards(1), "shards": 4, "memory": 10**9}, "executor: expected no target_error"),
    ):
        with pytest.raises(ValueError, match=sentence):
            ob.uncertainty(courtyard, cameras, **arguments, **SMALL)


def test_dask_runs_what_a_killed_worker_lost(courtyard, cameras, undisturbed, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        first = set(client.run(os.getpid).values())
        killed = []

        def kill(stage, done, total):
            if done == 1:
                victim = next(iter(client.run(os.getpid).values()))
                os.kill(victim, signal.SIGKILL)
                killed.append(victim)

        settings = {"shards": 5, "keep_sums": True, **SMALL, "progress": kill}
        field = ob.uncertainty(courtyard, cameras, executor=client.get_executor(), **settings)
        assert killed and killed[0] in first
        deadline = time.monotonic() + 30
        while killed[0] in (now := set(client.run(os.getpid).values())) and time.monotonic() < deadline:
            time.sleep(0.2)
        assert killed[0] not in now, "another process has taken its place"
    assert content(field, tmp_path) == content(undisturbed, tmp_path)
