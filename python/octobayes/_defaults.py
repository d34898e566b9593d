"""The library's defaults, which stand once: in Rust."""

from __future__ import annotations

import json
from types import SimpleNamespace

from . import _octobayes

#: By the names of arguments.
DEFAULT = SimpleNamespace(**json.loads(_octobayes.defaults()))
