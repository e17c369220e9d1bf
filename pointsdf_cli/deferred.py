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
from types import FrameType, ModuleType
from typing import Any

LEAVES = (
    "PIL.Image",
    "h5py",
    "networkx",
    "numpy.f2py",
    "numpy.ma",
    "numpy.polynomial",
    "numpy.testing",
    "pydoc",
)
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

PROMISED = {("networkx", "trimesh.base"): ("Graph",)}
"""Names that one module takes from another as it loads, only for annotations: it gets stand-ins,
which load what they stand for should they be called."""

DOCUMENTED = "scipy._lib._array_api"
"""Module that parses and rewrites the docstrings of most of SciPy's functions as they load. Nobody
reads them here."""

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
        _load([fullname.rpartition(".")[0]])  # what is inside a package comes after the package
        loaded = sys.modules.get(fullname)  # by its package
        if loaded is not None and loaded.__spec__ is not None:
            # In the module too: Python prefers the spec that it finds there.
            loaded.__spec__ = ModuleSpec(fullname, _Loaded(loaded.__spec__))
            return loaded.__spec__
        if fullname not in self._names and fullname != DOCUMENTED:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and spec.loader is not None:
            kind = _Undocumented if fullname == DOCUMENTED else _Later
            spec.loader = kind(spec.loader)
        return spec


class _Later(Loader):
    def __init__(self, loader: Loader) -> None:
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _Deferred(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """Nothing yet."""


class _Loaded(Loader):
    """Loads a module that is loaded already, whose spec this is."""

    def __init__(self, spec: ModuleSpec) -> None:
        self.spec = spec

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return sys.modules[spec.name]

    def exec_module(self, module: ModuleType) -> None:
        """Only put the module's spec back."""
        module.__spec__ = self.spec


class _Undocumented(Loader):
    """Loads `DOCUMENTED` with a parser of docstrings that does nothing."""

    def __init__(self, loader: Loader) -> None:
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Run the module, then exchange its parser, if it has one."""
        self.loader.exec_module(module)
        if hasattr(module, "FunctionDoc"):
            vars(module)["FunctionDoc"] = _NoDocstring


class _NoDocstring:
    """A function's docstring that has no sections."""

    def __init__(self, function: object) -> None:
        """Nothing is read."""

    def __getitem__(self, section: str) -> list[str]:
        return []

    def __str__(self) -> str:
        return "\n"


class _Deferred(ModuleType):
    """A module that runs when an attribute is asked for that it does not have yet."""

    def __getattr__(self, name: str) -> Any:
        # No variable holds an error: its traceback would keep alive all that callers hold.
        if name in _LOOKED_FOR:
            raise self._lacks(name)
        if name in PROMISED.get((self.__name__, _asking()), ()):
            return _stand_in(self, name)
        with _loading:
            if not self._run() and type(self) is _Deferred:
                raise self._lacks(name)  # asked for by what it imports while it runs
        return getattr(self, name)

    def _lacks(self, name: str) -> AttributeError:
        return AttributeError(f"module {self.__name__!r} has no attribute {name!r}")

    def _run(self) -> bool:
        """Run the module's code unless that was begun; whether it was run now."""
        spec = self.__spec__
        if spec is None or not isinstance(spec.loader, _Later):
            return False
        self.__loader__ = spec.loader = spec.loader.loader
        spec.loader.exec_module(self)
        object.__setattr__(self, "__class__", ModuleType)
        return True


def _asking() -> str:
    """Name of the module that asks a deferred module for an attribute."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return "" if frame is None else str(frame.f_globals.get("__name__", ""))


def _stand_in(module: ModuleType, name: str) -> type:
    """A class whose call is a call of the module's function or class of that name."""

    def called(cls: type, *values: Any, **named: Any) -> Any:
        return getattr(module, name)(*values, **named)

    return type(name, (), {"__new__": called, "__module__": module.__name__})


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
