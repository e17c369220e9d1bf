"""Refusal of outputs that are also inputs, even with --force.

Files are compared by identity, so links and other spellings of a path are recognised.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.meshes import MESH_SUFFIXES

CHECKPOINT = ("config.json", "model.safetensors", "train_state.pt")
READ = (".h5", ".hdf5", ".urdf", ".yaml", *MESH_SUFFIXES)
"""Suffixes of the files read from an input folder; tables and pages may be written there."""


def require_apart(outputs: Iterable[Path | None], inputs: Iterable[Path | str | None]) -> None:
    """Refuse an output that is an input, or a file in an input folder that is read.

    Args:
        outputs: Files and folders to be written; None is passed over.
        inputs: Files and folders to be read, or what a user typed in place of a file; None and
            what is no file are passed over.

    Raises:
        InputError: An output is also an input.
    """
    there = [path for path in outputs if path is not None and path.exists()]
    if not there:
        return
    read = {_identity(file) for source in inputs for file in _files_of(source)}
    for path in there:
        if _identity(path) in read:
            raise InputError(
                "is an input, which the output would replace",
                where=path,
                allowed="a place of its own for what is written, with --force too",
                hint="choose another name",
            )


def require_outside(output: Path | None, folder: Path, option: str) -> None:
    """Refuse an output folder within an input folder, where it would be read as input next time.

    Args:
        output: Folder to be written; None is passed over.
        folder: Folder to be read.
        option: Option of the output, for the message.

    Raises:
        InputError: It lies within the input folder.
    """
    if output is not None and folder.resolve() in output.resolve().parents:
        raise InputError(
            f"lies within {folder}, all of which is read",
            where=f"{option} {output}",
            allowed="a folder of its own",
            hint=f"{option} {folder.resolve().with_name(f'{folder.resolve().name}-{output.name}')}",
        )


def _identity(path: Path) -> tuple[int, int]:
    about = path.stat()
    return about.st_dev, about.st_ino


def _files_of(source: Path | str | None) -> Iterator[Path]:
    """A file with the files it may name beside it, or a folder with its input files."""
    if source is None:
        return
    if not os.path.exists(source):  # unlike Path's, it takes names of any length
        source = re.sub(r":\d+$", "", str(source))  # MASK:NUMBER
    if not os.path.exists(source):
        return
    source = Path(source)
    yield source
    if source.suffix.lower() in (".yaml", ".yml"):  # of a robot, perhaps, which lies beside it
        yield from source.parent.glob("*.urdf")
    for path in source.rglob("*") if source.is_dir() else ():
        if (path.suffix.lower() in READ or path.name in CHECKPOINT) and path.is_file():
            yield path
