"""Damages below a checksum: HDF5 files rewritten with other contents, archives packed again.

A flipped bit in such a file only tests its checksum; a stranger can make a file whose checksums
hold.
"""

from __future__ import annotations

import gzip
import io
import zlib

import h5py
import numpy as np

from .mutations import mutate


def mutate_hdf5(data: bytes, rng: np.random.Generator) -> bytes:
    """An HDF5 file in which one to three attributes or datasets are of another kind or gone."""
    image = io.BytesIO(data)
    with h5py.File(image, "a") as file:
        for _ in range(rng.integers(1, 4)):
            spoil = (_spoil_attribute, _spoil_dataset, _spoil_numbers, _lead_elsewhere)
            spoil[rng.choice(4, p=(0.35, 0.35, 0.2, 0.1))](file, rng)
    return image.getvalue()


def mutate_gzip(data: bytes, rng: np.random.Generator) -> bytes:
    """A gzip file whose contents are damaged and whose checksum fits them."""
    try:
        return gzip.compress(mutate(gzip.decompress(data), rng), 1, mtime=0)
    except (OSError, EOFError, zlib.error):
        return mutate(data, rng)


def _value(rng: np.random.Generator) -> object:
    values = (
        "", "x" * 3000, "{", "[1, 2]", '"a"', "[" * 3000, b"\xff\xfe", -1, 2**40, np.nan, np.inf,
        1e300, True, [], ["a"], np.zeros((2, 2)), np.array([b"\xff"]), np.zeros(0), None,
        {"shape": (1 << 40,)}, h5py.Empty("f4"), np.arange(3), np.array(3.5),
    )  # fmt: skip
    return values[rng.integers(len(values))]


def _spoil_attribute(file: h5py.File, rng: np.random.Generator) -> None:
    names = list(file.attrs)
    if not names:
        return
    name, value = names[rng.integers(len(names))], _value(rng)
    if value is None:
        del file.attrs[name]
    elif not isinstance(value, dict):
        file.attrs[name] = value


def _spoil_numbers(file: h5py.File, rng: np.random.Generator) -> None:
    """Numbers that a dataset of that shape and kind can hold, and none that makes sense."""
    arrays = [name for name in file if isinstance(file.get(name), h5py.Dataset)]
    arrays = [n for n in arrays if file[n].shape and 0 < file[n].size < 1 << 20]
    arrays = [
        n
        for n in arrays
        if file[n].dtype.kind in "fiu" and not (file[n].external or file[n].is_virtual)
    ]
    if not arrays:
        return
    name = arrays[rng.integers(len(arrays))]
    array = file[name][()]
    floats = (np.nan, np.inf, 0.0, -1.0, 1e30, 1e-30)
    wholes = (0, -1, 100, 127)
    value = floats[rng.integers(6)] if array.dtype.kind == "f" else wholes[rng.integers(4)]
    if rng.random() < 0.5:
        array[...] = value
    else:
        array.flat[rng.integers(array.size)] = value
    file[name][...] = array


def _lead_elsewhere(file: h5py.File, rng: np.random.Generator) -> None:
    """Links, data in other files, and groups within groups, in place of a dataset or beside it."""
    names = [*file, "more"]
    name = names[rng.integers(len(names))]
    if name in file:
        del file[name]
    kind = rng.integers(6)
    if kind == 0:
        file[name] = h5py.ExternalLink("/etc/hostname", "/data")
    elif kind == 1:
        file.create_dataset(name, (4, 3), "u1", external=[("/etc/passwd", 0, 12)])
    elif kind == 2:
        layout = h5py.VirtualLayout((4,), "f4")
        layout[:] = h5py.VirtualSource("/nowhere.h5", "x", (4,))
        file.create_virtual_dataset(name, layout)
    elif kind == 3:
        group = file.create_group(name)
        for _ in range(int(rng.choice([3, 30, 300]))):
            group = group.create_group("a")
    elif kind == 4:
        file[name] = file["/"]  # the file within itself
    else:
        file.attrs.create("much", np.zeros(7000))


def _spoil_dataset(file: h5py.File, rng: np.random.Generator) -> None:
    names = list(file)
    if not names:
        return
    name = names[rng.integers(len(names))]
    found, value = file.get(name), _value(rng)
    whole = isinstance(found, h5py.Dataset) and found.shape and found.size < 1 << 20
    array = found[()] if whole else np.zeros(3)
    del file[name]
    if value is None:
        file.create_group(name)
    elif isinstance(value, dict):  # promises a terabyte and holds nothing
        file.create_dataset(name, shape=value["shape"], dtype="f8", chunks=(1 << 16,))
    elif rng.random() < 0.5:
        shapes = (array[:1], array[:0], array[..., :1], array.astype("S5"), array.ravel())
        file[name] = shapes[rng.integers(len(shapes))]
    elif isinstance(value, str) and not value:
        file[name] = h5py.SoftLink("/nowhere")
    else:
        file[name] = value
