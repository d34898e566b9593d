"""Progress as calls, or as a bar of tqdm."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

from ._arguments import wrong

Progress = Callable[[str, int, int], Any]


class _Bar:
    """One bar of tqdm for each stage."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bar: Any = None
        self._stage: tuple[str, int] | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        if (stage, total) != self._stage or self._bar is None or done < self._bar.n:
            self.close()
            self._bar, self._stage = self._tqdm(total=total, desc=stage, leave=False, unit_scale=True), (stage, total)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
        self._bar = None


def _is_watched() -> bool:
    """Whether somebody sees a bar: at a terminal or in a notebook."""
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


@contextlib.contextmanager
def reporting(progress: Progress | bool | None) -> Iterator[Progress | None]:
    """What to call. ``None`` is a bar if tqdm is installed and somebody watches, ``True`` a bar, ``False`` nothing."""
    if progress is False or (progress is None and not _is_watched()):
        yield None
    elif progress is None or progress is True:
        try:
            from tqdm.auto import tqdm  # type: ignore[import-untyped]
        except ImportError as error:
            if progress is True:
                raise ImportError("progress: expected tqdm to be installed for True, found it missing") from error
            yield None
            return
        bar = _Bar(tqdm)
        try:
            yield bar
        finally:
            bar.close()
    elif callable(progress):
        yield progress
    else:
        raise wrong("progress", "a callable (stage, done, total), True, False or None", progress)
