"""Runs in shards on executors of other packages.

There is no scheduler here. A shard is idempotent, small to describe and exact: every run of it, on any machine, gives
the same bytes. An executor that loses a worker runs its shard again by its own means.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _octobayes
from ._arguments import whole, wrong
from ._gate import Gate, remarks
from ._model import Opened
from ._uncertainty import Uncertainty

# Arguments that belong to one process.
ALONE = ("shard", "checkpoint", "dump_samples", "error_bars")


@dataclass(frozen=True)
class Task:
    """Everything a shard needs; picklable if a callable in it is."""

    nerf: Any
    gate: Mapping[str, Any]
    rows: NDArray[np.float64]
    options: Mapping[str, Any]

    def __call__(self, index: int, of: int) -> tuple[Uncertainty, list[tuple[str, bool]], float]:
        """Computes shard ``index`` of ``of``. Runs in a worker. Returns the gate's overshoot, too."""
        asked = self.nerf._model if isinstance(self.nerf, Opened) else Gate(self.nerf, **self.gate)
        options = {**self.options, "shard": [index, of], "keep_sums": True}
        # What came through somebody's serialisation need not be aligned.
        rows = np.array(self.rows)
        field, said, _ = _octobayes.uncertainty(asked, rows, options, None)
        return Uncertainty(field), said, getattr(asked, "overshoot", 0.0)


class Tree:
    """Merges parts two by two, always the same two: the result does not depend on which comes first.

    No more parts wait than shards are under way, and one for each level of the tree.
    """

    def __init__(self, leaves: int) -> None:
        self._widths = [leaves]
        while self._widths[-1] > 1:
            self._widths.append((self._widths[-1] + 1) // 2)
        self._waiting: dict[tuple[int, int], Any] = {}

    def add(self, index: int, part: Any) -> Any | None:
        """Adds a leaf; returns the whole once all have come."""
        for level, width in enumerate(self._widths[:-1]):
            sibling = index ^ 1
            if sibling < width:
                other = self._waiting.pop((level, sibling), None)
                if other is None:
                    self._waiting[level, index] = part
                    return None
                pair = [part, other] if index < sibling else [other, part]
                part, _ = _octobayes.merge(pair, False, True)
            index //= 2
        return part

    def __len__(self) -> int:
        return len(self._waiting)


def checked(executor: Any, shards: Any, arguments: Mapping[str, Any], is_dry: bool) -> int:
    """The number of shards, if these arguments go with an executor."""
    if not callable(getattr(executor, "submit", None)):
        raise wrong("executor", "a concurrent.futures.Executor, or anything with its submit", executor)
    for name in ALONE:
        if arguments[name] is not None:
            raise wrong(name, "None with an executor, which has shards of its own", arguments[name])
    if is_dry:
        raise wrong("executor", "None for a forecast, which is of the whole run", "one")
    return whole("shards", shards, 1, 1 << 20)


def run(
    task: Task, executor: Executor, shards: int, report: Callable[[str, int, int], Any] | None
) -> tuple[_octobayes.Uncertainty, list[tuple[str, bool]]]:
    """Runs all shards, and merges them as they come. The first exception cancels what has not begun."""
    indices: dict[Future[Any], int] = {executor.submit(task, i, shards): i for i in range(shards)}
    tree, said, merged, most = Tree(shards), dict[tuple[str, bool], None](), None, 0.0
    pending = set(indices)
    try:
        while pending:
            # So that Ctrl-C is seen.
            done, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=indices.__getitem__):
                part, texts, overshoot = future.result()
                said.update(dict.fromkeys(texts))
                most = max(most, overshoot)
                merged = tree.add(indices.pop(future), part._field)
                if report is not None:
                    report("shards", shards - len(indices), shards)
    finally:
        for future in pending:
            future.cancel()
    assert merged is not None, "all shards have come"
    return merged, [*said, *remarks(most)]
