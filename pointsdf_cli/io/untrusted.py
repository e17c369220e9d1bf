"""Text and arrays from untrusted files: YAML, JSON, XML and NPY, damaged or malicious.

A file of a few hundred bytes can ask for terabytes: by a length in a header, by aliases of aliases,
by entities of entities, by a thousand brackets. Each reader here refuses that in one message.
"""

from __future__ import annotations

import json
import re
import tokenize
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, BinaryIO, Literal
from xml.parsers import expat

import numpy as np
import yaml
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import open_input, read_input

MOST_NODES = 100_000
DEEPEST = 100
NPY_ERRORS = (
    ValueError, EOFError, OSError, SyntaxError, TypeError, OverflowError, RecursionError,
    MemoryError, tokenize.TokenError,
)  # fmt: skip
"""Errors of NumPy's parser of NPY headers, which are Python expressions."""


def read_yaml(path: Path, first_document: bool = False) -> Any:
    """The plain data of a YAML file, or of one that OpenCV wrote.

    Args:
        path: The file.
        first_document: Leave out what follows `---`, where more is refused otherwise.

    Raises:
        InputError: Not YAML, a key that stands twice in a mapping, or more than `MOST_NODES` nodes
            once its aliases are followed.
    """
    text = _text(path, "YAML", "YAML")
    if text.startswith("%YAML"):
        # OpenCV has tags of its own, and its releases before 5 begin with `%YAML:1.0`.
        text = re.sub(r"!!opencv-[a-z-]+", "", text.replace("%YAML:", "%YAML ", 1))
    try:
        loader = yaml.SafeLoader(text)
        if first_document:
            node = loader.get_node() if loader.check_node() else None
        else:
            node = loader.get_single_node()
        if node is None:
            return None
        _check_nodes(node, path)  # before `<<: *alias` copies what it leads to
        return loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a 13th month
        raise InputError(f"is not YAML ({first_line(error)})", where=path) from error


def read_json(path: Path) -> Any:
    """The data of a JSON file.

    Raises:
        InputError: Not JSON.
    """
    return parse_json(_text(path, "text", "JSON"), path)


def is_whole_number(text: str) -> bool:
    """Whether a text is a whole number from 0 of at most nine digits, which `int` can take."""
    return text.isascii() and text.isdecimal() and len(text) < 10


def parse_json(text: str | bytes, where: object) -> Any:
    """The data of a JSON text.

    Args:
        text: The text.
        where: Its source, for messages.

    Raises:
        InputError: Not JSON, or a key stands twice in one object.
    """

    def distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            what = f"`{twice[:60]}` stands a second time in it"
            raise InputError(what, where=where, allowed="each key once")
        return found

    try:
        return json.loads(text, object_pairs_hook=distinct)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not readable JSON ({first_line(error)})", where=where) from error


def read_xml(path: Path) -> ET.Element:
    """The root element of an XML file without entities of its own.

    Raises:
        InputError: Not XML, entities are declared, or elements nest deeper than `DEEPEST`.
    """
    data = read_input(path, "text")
    try:
        _check_xml(data)
        return ET.fromstring(data)
    except (ET.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"is not XML ({first_line(error)})", where=path) from error


def read_npy_array(path: Path, kind: str = "array") -> NDArray[Any]:
    """Memory-mapped array of a .npy file: nothing beyond the stored bytes is allocated.

    Args:
        path: The file.
        kind: Kind of input, which bounds its size (`input_files.LARGEST`).

    Raises:
        InputError: Damaged, cut short, or of Python objects.
    """
    try:
        with open_input(path, kind) as handle:
            return _mapped(handle)
    except NPY_ERRORS as error:
        raise InputError("is not a NumPy array, or is cut short", where=path) from error


def read_npy_header(handle: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape of an array in an open NPY file, whether it is stored by columns, and its type.

    Raises:
        ValueError: Damaged, or of another version; numpy's parser raises more.
    """
    version = np.lib.format.read_magic(handle)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version}")
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(handle)
    return np.lib.format.read_array_header_2_0(handle)


def _mapped(handle: BinaryIO) -> NDArray[Any]:
    """Map an array of an open NPY file into memory, like `np.lib.format.open_memmap`."""
    shape, by_columns, dtype = read_npy_header(handle)
    if dtype.hasobject:
        raise ValueError("Python objects")
    if not dtype.itemsize:  # any number of them fits into no bytes at all
        raise ValueError("values of no size")
    order: Literal["F", "C"] = "F" if by_columns else "C"
    if 0 in shape:
        return np.zeros(shape, dtype, order)
    return np.memmap(handle, dtype, "r", handle.tell(), shape, order)


def _text(path: Path, kind: str, form: str) -> str:
    try:
        return read_input(path, kind).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is not {form} (no UTF-8 text)", where=path) from error


def _check_nodes(root: yaml.Node, path: Path) -> None:
    """Refuse keys that stand twice, and more than `MOST_NODES` nodes with aliases followed."""
    waiting, seen = [root], 0
    while waiting:
        node = waiting.pop()
        seen += 1
        if seen > MOST_NODES:
            what = "holds too much once its aliases are followed"
            raise InputError(what, where=path, allowed=f"{MOST_NODES} entries")
        if isinstance(node, yaml.MappingNode):
            keys = set()
            for pair in node.value:
                waiting += pair
                key = pair[0]
                if not isinstance(key, yaml.ScalarNode) or key.value == "<<":
                    continue
                if (key.tag, key.value) in keys:  # PyYAML would take the last one
                    again = f"line {key.start_mark.line + 1}"
                    what = f"`{key.value[:60]}` stands a second time, in {again}"
                    raise InputError(what, where=path, allowed="each key once")
                keys.add((key.tag, key.value))
        elif isinstance(node, yaml.SequenceNode):
            waiting += node.value


def _check_xml(data: bytes) -> None:
    parser, depth = expat.ParserCreate(), 0

    def start(_name: str, _attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"elements nest deeper than {DEEPEST}")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(*_about: object) -> None:
        raise ValueError("it declares entities")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.EntityDeclHandler = entity
    parser.Parse(data, True)


def first_line(error: Exception) -> str:
    """First line of an error, cut to fit into a message; its type if it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
