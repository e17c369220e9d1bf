"""Lazy import of Open3D without its notebook drawing.

`import open3d` also imports plotly, dash and IPython for one function that shows figures in a
notebook: more than half of its time. That one module is left out while Open3D loads.
"""

from __future__ import annotations

import importlib
import sys
from functools import cache
from threading import Lock
from types import ModuleType
from typing import Any

_NOTEBOOK = "open3d.visualization.draw_plotly"
_ITS_NAMES = ("get_plotly_fig", "draw_plotly", "draw_plotly_server")


class _Open3D:
    """The module `open3d`, imported when the first of its names is asked for."""

    def __getattr__(self, name: str) -> Any:
        return getattr(_open3d(), name)


o3d: Any = _Open3D()


_LOADING = Lock()
"""Held while Open3D loads: another thread would find the module half made."""


def _open3d() -> ModuleType:
    with _LOADING:
        return _loaded()


@cache
def _loaded() -> ModuleType:
    if "open3d" in sys.modules:
        return importlib.import_module("open3d")  # waits for an import in another thread
    empty = ModuleType(_NOTEBOOK)
    for name in _ITS_NAMES:
        setattr(empty, name, None)
    sys.modules[_NOTEBOOK] = empty
    try:
        return importlib.import_module("open3d")
    finally:
        # Whoever wants it can still import it by its own name.
        if sys.modules.get(_NOTEBOOK) is empty:
            del sys.modules[_NOTEBOOK]
