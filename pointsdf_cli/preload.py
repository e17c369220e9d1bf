"""Shared libraries that a thread loads while Python imports other modules.

Importing torch or Open3D spends about a third of its time in the system's loader, which needs
neither Python nor its lock. An import that comes later finds the library loaded.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import threading
from collections.abc import Iterable
from importlib.machinery import PathFinder
from pathlib import Path

_running: list[threading.Thread] = []

LIBRARIES = {"torch": "lib/libtorch_cpu.so", "open3d": "libOpen3D.so*"}
"""Package → pattern of its largest library without Python code, below the package's folder."""


def preload(packages: Iterable[str]) -> threading.Thread:
    """Load the libraries of these packages, keys of `LIBRARIES`, in a thread of its own.

    A library that is missing or cannot be loaded is left to its package's import, which says so.
    """
    paths = [path for package in packages for path in _libraries(package)]
    thread = threading.Thread(target=_load, args=(paths,), name="preload", daemon=True)
    _running.append(thread)
    atexit.register(wait)
    thread.start()
    return thread


def wait() -> None:
    """Wait until all is loaded: Python may not take a process apart in which a library begins."""
    while _running:
        _running.pop().join()


def _libraries(package: str) -> list[Path]:
    spec = PathFinder.find_spec(package)
    folders = list(spec.submodule_search_locations or []) if spec is not None else []
    return [path for folder in folders for path in sorted(Path(folder).glob(LIBRARIES[package]))]


def _load(paths: Iterable[Path]) -> None:
    # As a foreign function, which runs without Python's lock; `ctypes.CDLL(path)` holds it.
    load = ctypes.CDLL(None).dlopen
    load.argtypes, load.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    for path in paths:
        load(os.fsencode(path), os.RTLD_NOW | os.RTLD_LOCAL)
