"""Parts of libraries that load when they are first used, and not with the library.

Importing SciPy also imports NumPy's translator of Fortran, and importing torch its compiler's
tables: most of their time, for what no command uses.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any

LEAVES = ("numpy.f2py", "numpy.ma", "numpy.polynomial", "numpy.testing", "pydoc")
TORCH_LEAVES = (
    "torch._meta_registrations",  # shapes without data, for tracing and compiling
    "torch.distributions",
    "torch.export",
    "torch.masked",
    "torch.nested",
    "torch.utils.data",
)
TORCH = "2.13."
"""Version of torch whose imports are known to do without; others load whole."""

COMPILER = "torch._dynamo"
"""Loaded by optimisers, and written for a torch that was imported whole."""

_LOOKED_FOR = ("__path__", "__file__", "__cached__", "__warningregistry__")
"""Attributes that imports and warnings look for in any module."""

_loading = RLock()


def defer_unused() -> None:
    """Defer what no command uses, in this process and from now on."""
    names = [*LEAVES, *(TORCH_LEAVES if _torch_version().startswith(TORCH) else ())]
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder(names))


class _Finder(MetaPathFinder):
    """Finds the named modules where they are, with a loader that puts off running them."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = frozenset(names)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname == COMPILER:
            _load(TORCH_LEAVES)
        if fullname not in self._names:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and spec.loader is not None:
            spec.loader = _Later(spec.loader)
        return spec


class _Later(Loader):
    def __init__(self, loader: Loader) -> None:
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _Deferred(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """Nothing yet."""


class _Deferred(ModuleType):
    """A module that runs when an attribute is asked for that it does not have yet."""

    def __getattr__(self, name: str) -> Any:
        lacks = AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        if name in _LOOKED_FOR:
            raise lacks
        with _loading:
            if not self._run() and type(self) is _Deferred:
                raise lacks  # asked for by what it imports while it runs
        return getattr(self, name)

    def _run(self) -> bool:
        """Run the module's code unless that was begun; whether it was run now."""
        spec = self.__spec__
        if spec is None or not isinstance(spec.loader, _Later):
            return False
        self.__loader__ = spec.loader = spec.loader.loader
        spec.loader.exec_module(self)
        object.__setattr__(self, "__class__", ModuleType)
        return True


def _load(names: Iterable[str]) -> None:
    """Run what was deferred of these modules."""
    with _loading:
        for name in names:
            module = sys.modules.get(name)
            if isinstance(module, _Deferred):
                module._run()


def _torch_version() -> str:
    """Version of the torch that would be imported, empty if there is none."""
    spec = PathFinder.find_spec("torch")
    if spec is None or spec.origin is None:
        return ""
    try:
        lines = Path(spec.origin).with_name("version.py").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    told = (line.partition("=")[2] for line in lines if line.startswith("__version__"))
    return next(told, "").strip().strip("'\"")
