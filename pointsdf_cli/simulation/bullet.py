"""Physics clients of PyBullet, and suppression of the output of its C code on stdout."""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import sys
from collections.abc import Iterator
from typing import Any

from pointsdf_cli.errors import RgraspError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import wxyz_from_rotation


class Bullet:
    """PyBullet's functions and constants, for one physics client of its own; it is imported
    without its greeting on stdout.

    Raises:
        RgraspError: PyBullet is not installed.
    """

    def __init__(self) -> None:
        try:
            with silence():
                import pybullet
        except ImportError as error:
            raise RgraspError(
                "the simulator needs PyBullet, which is not installed",
                hint="with Python 3.11, in rgrasp's folder: pip install -c constraints.txt "
                "'.[sim]' (PyBullet has no wheels for newer Pythons)",
            ) from error
        self._module: Any = pybullet
        self._client = self._module.connect(self._module.DIRECT)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        if inspect.isbuiltin(found):
            return functools.partial(found, physicsClientId=self._client)
        return found


def bullet_place(pose: Array) -> tuple[list[float], list[float]]:
    """Position [3] and quaternion [4], scalar last, of a pose [4, 4] as PyBullet takes them."""
    return pose[:3, 3].tolist(), wxyz_from_rotation(pose[:3, :3])[[1, 2, 3, 0]].tolist()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Suppress the output of PyBullet's C code."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        yield
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(sink)
