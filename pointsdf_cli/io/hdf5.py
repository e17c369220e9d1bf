"""HDF5 artifacts: one file an object or scene, with schema, units, frames and provenance.

Root attributes of every artifact: `schema`, `schema_version`, `created_by`, `git_commit`, `seed`,
`config_json`, `length_unit`. Every dataset carries `units` and `frame`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.hdf5_heap import heaps_end
from pointsdf_cli.io.hdf5_objects import datasets_of
from pointsdf_cli.io.input_files import check_input, is_hidden
from pointsdf_cli.io.layout import Layout, check_layout, check_stored
from pointsdf_cli.io.provenance import created_by, git_commit


class OptionsDifferError(InputError):
    """A finished artifact was made with other options: the user must decide, so a stage stops."""

    @classmethod
    def of_file(cls, path: Path, what: str) -> OptionsDifferError:
        """The error for a file that `what` is said of."""
        hint = "choose another --out, or add --force to replace it"
        return cls(what, where=path, hint=hint)


def changed_options(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> list[str]:
    """Names of the options that differ, sorted."""
    return sorted(k for k in ours.keys() | theirs.keys() if ours.get(k) != theirs.get(k))


def flattened(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings as one level: {"model.width": 256, ...}; lists stay as they are."""
    flat: dict[str, Any] = {}
    for name, value in config.items():
        if isinstance(value, Mapping) and value:
            flat |= flattened(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


NO_SEED = -1
"""The `seed` attribute of an artifact in which nothing was drawn."""

_CHUNK = 1 << 20
"""Approximate number of bytes with one checksum."""


@dataclass(frozen=True)
class Artifact:
    """The contents of one file.

    Attributes:
        path: The file.
        attributes: Root attributes by name.
        datasets: Arrays by name.
        config: Options that the file was made with.
    """

    path: Path
    attributes: dict[str, Any]
    datasets: dict[str, np.ndarray]
    config: dict[str, Any]

    @property
    def values(self) -> dict[str, Any]:
        """The datasets by name, those of text as tuples of strings."""
        return {
            name: tuple(text.decode() for text in array.tolist())
            if array.dtype.kind == "S"
            else array
            for name, array in self.datasets.items()
        }


def write_artifact(
    path: Path | str,
    schema: str,
    version: int,
    layout: Layout,
    arrays: Mapping[str, Any],
    *,
    attributes: Mapping[str, Any] | None = None,
    seed: int | None = None,
    config: Mapping[str, Any] | None = None,
) -> None:
    """Write one artifact as a whole or not at all.

    Datasets hold no time stamps, so equal contents give equal files.

    Args:
        path: The file.
        schema, version: Schema and version of the artifact.
        layout: The datasets to write.
        arrays: Their arrays, or lists of numbers or strings, by name; others are left out.
        attributes: Further attributes.
        seed: Random seed; None if nothing was drawn.
        config: Options that the file was made with.

    Raises:
        InputError: The place cannot be written, or the disk is full.
    """
    # In memory first: HDF5 that meets a full disk while it closes a file takes the process along.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        file.attrs["schema"] = schema
        file.attrs["schema_version"] = version
        file.attrs["created_by"] = created_by()
        file.attrs["git_commit"] = git_commit()
        file.attrs["seed"] = NO_SEED if seed is None else seed
        file.attrs["config_json"] = json.dumps(dict(config or {}), sort_keys=True)
        file.attrs["length_unit"] = "m"
        for name, value in (attributes or {}).items():
            file.attrs[name] = value
        for name, column in layout.items():
            array = arrays[name]
            if column.kind == "S":
                array = np.array([text.encode() for text in array], dtype="S")
            elif isinstance(array, list):
                array = np.array(array, dtype=column.kind)
            packing = _packing(np.asarray(array), column.compress)
            stored = file.create_dataset(name, data=array, track_times=False, **packing)
            stored.attrs["units"] = column.units
            stored.attrs["frame"] = column.frame
    with atomic_path(path) as temporary:
        temporary.write_bytes(image.getbuffer())


def _packing(array: np.ndarray, compress: bool) -> dict[str, Any]:
    """Options of a dataset: checksums, as damage shows nowhere else in what is not compressed."""
    squeeze = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if compress else {}
    if not (array.ndim and array.size):
        return squeeze  # HDF5 has no checksum for single numbers
    if not compress:  # chunks of whole rows: the library's own take twice as long
        parts = -(-array.nbytes // _CHUNK)
        squeeze = {"chunks": (-(-len(array) // parts), *array.shape[1:])}
    return squeeze | {"fletcher32": True}


def read_artifact(
    path: Path | str,
    *,
    schema: str,
    version: int,
    names: Layout | None = None,
    optional: Layout | None = None,
) -> Artifact:
    """Read an artifact of the given schema, all of its datasets or those of a layout.

    Args:
        path: The file.
        schema, version: Required schema and version.
        names: The layout of the datasets to read; None for all, whatever they are.
        optional: Datasets that are read and checked too where they are there.

    Raises:
        InputError: No such file, not HDF5, cut short, another schema or version, or a dataset
            of `names` is missing or not of its layout.
    """
    path = Path(path)
    with open_hdf5(path) as file:
        _require_schema(path, file, schema, version)
        wanted = sorted(file) if names is None else list(names)
        missing = [name for name in wanted if name not in file]
        if missing:
            raise InputError(
                f"lacks the dataset {', '.join(missing)}",
                where=path,
                allowed=f"a {schema} file (version {version}); this one holds "
                + (", ".join(sorted(file)) or "nothing"),
            )
        there = {name: column for name, column in (optional or {}).items() if name in file}
        wanted += [name for name in there if name not in wanted]
        check_layout(path, file, {**(names or {}), **there})
        for name in wanted:
            check_stored(path, file, name)
        datasets = {name: np.asarray(file[name][()]) for name in wanted}
        return Artifact(path, dict(file.attrs), datasets, options_of(file))


@contextmanager
def attributes_as_input_error(path: Path | str) -> Iterator[None]:
    """Context that turns errors of missing or malformed attributes into one InputError.

    Raises:
        InputError: A dataset or attribute is missing or of another kind: not a file that rgrasp
            wrote.
    """
    senseless = (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError)
    try:
        yield
    except (*senseless, ArithmeticError) as error:
        raise InputError(
            "lacks an attribute, or holds one that makes no sense "
            f"({type(error).__name__}: {str(error)[:80]})",
            where=path,
            allowed="a file as rgrasp writes it",
            hint="make it again",
        ) from error


@contextmanager
def open_hdf5(path: Path | str) -> Iterator[h5py.File]:
    """An HDF5 file open for reading; all its data must be stored in the file itself.

    Raises:
        InputError: No ordinary file, not HDF5, cut short, damaged where it is read, or it leads to
            other files (`hdf5_objects.py`).
    """
    path = Path(path)
    check_input(path, "artifact")
    try:
        if not heaps_end(path):
            raise OSError("a damaged heap of strings")
        with h5py.File(path, "r") as file:
            datasets_of(path, file)
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        # The library finds damage where it comes by, in attributes as well as in datasets.
        raise InputError(
            "cannot be read as HDF5: not such a file, damaged or cut short",
            where=path,
            allowed="a whole .h5 file written by rgrasp",
            hint="move it away, if it is one, and run the stage again: it makes only what is "
            f"missing ({(str(error).splitlines() or ['no more is known'])[0][:120]})",
        ) from error


def artifacts_below(folder: Path) -> list[Path]:
    """The finished .h5 files of a folder and those below, without hidden ones."""
    return [path for path in sorted(folder.rglob("*.h5")) if not is_hidden(path, folder)]


def schema_of(path: Path) -> str:
    """The schema that an HDF5 file states, in words if it states none."""
    with open_hdf5(path) as file:
        return str(file.attrs.get("schema", "nothing that rgrasp wrote"))


def options_of(file: h5py.File) -> dict[str, Any]:
    """Configuration stored in an open artifact.

    Raises:
        InputError: It does not say so in JSON.
    """
    with attributes_as_input_error(Path(file.filename)):
        return dict(json.loads(file.attrs.get("config_json", "{}")))  # text or bytes


def mesh_unit(file: h5py.File) -> str:
    """The unit that the mesh of an open artifact was read in, metres where none is named.

    Raises:
        InputError: As `options_of`.
    """
    return str(options_of(file).get("unit", "m"))


def is_complete(path: Path | str, *, schema: str, version: int, config: Mapping[str, Any]) -> bool:
    """Whether `path` already holds this artifact made with these options, so it can be kept.

    Raises:
        OptionsDifferError: The file is there but was made with other options: work of the user's
            that a resumed stage must not replace in silence.
        InputError: It is no artifact of this schema.
    """
    path = Path(path)
    if not path.exists():
        return False
    with open_hdf5(path) as file:
        _require_schema(path, file, schema, version)
        theirs = options_of(file)
    ours = json.loads(json.dumps(dict(config)))
    if theirs != ours:
        theirs, ours = flattened(theirs), flattened(ours)
        changed = changed_options(theirs, ours)
        differences = ", ".join(f"{k}: {theirs.get(k)} there, {ours.get(k)} now" for k in changed)
        raise OptionsDifferError.of_file(path, f"was made with other options ({differences})")
    return True


def require_schema(path: Path, schema: str) -> None:
    """Require that a file is an artifact of a schema, of any version.

    Raises:
        InputError: It is of another one, or cannot be read.
    """
    with open_hdf5(path) as file:
        _named_schema(path, file, schema)


def _named_schema(path: Path, file: h5py.File, schema: str) -> None:
    found = file.attrs.get("schema")
    if found is None:
        what = "is HDF5 but no rgrasp artifact (it has no `schema` attribute)"
        raise InputError(what, where=path, allowed=f"a {schema} file written by rgrasp")
    if str(found) != schema:
        what = f"holds {found}, and {schema} is needed"
        raise InputError(what, where=path, hint=f"rgrasp info {path} shows what it is")


def _require_schema(path: Path, file: h5py.File, schema: str, version: int) -> None:
    _named_schema(path, file, schema)
    theirs = file.attrs.get("schema_version")
    if not isinstance(theirs, (int, np.integer)) or int(theirs) != version:
        age = "older" if isinstance(theirs, (int, np.integer)) and theirs < version else "another"
        raise InputError(
            f"is {age} version of the {schema} schema ({theirs})",
            where=path,
            allowed=f"version {version}",
            hint="make it again with this rgrasp, or read it with the one that made it "
            f"({file.attrs.get('created_by', 'unknown')})",
        )
