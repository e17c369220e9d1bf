"""Small damages to a file, as broken transfers, other programs and ill will make them."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]+")
_NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e308", b"1e-320", b"4294967295", b"2147483648",
    b"9223372036854775808", b"99999999999999999999999", b"1e400", b"", b"1.5", b"[]", b"{}", b"'",
    b"null", b"true", b"0x10", b"2026-13-45",
)  # fmt: skip
_WORDS = (b"", b"x", b"None", b"../../../etc/passwd", b"\xff\xfe", b"a" * 5000, b"[[1]]", b"&a *a")
_BYTES = np.array([0x00, 0x01, 0x7F, 0x80, 0xFF, 0x0A, 0x20, 0x22, 0x2D, 0x30], np.uint8)


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """`data` with one to four damages."""
    for _ in range(rng.integers(1, 5)):
        damage = _DAMAGES[rng.integers(len(_DAMAGES))]
        data = damage(data, rng)
    return data


def _somewhere(data: bytes, rng: np.random.Generator) -> int:
    """A place in the file; every other time in its first part, where headers are."""
    end = len(data) if rng.random() < 0.5 else min(len(data), 400)
    return int(rng.integers(end + 1))


def _flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    array = np.frombuffer(data, np.uint8).copy()
    for _ in range(rng.integers(1, 9) if len(array) else 0):
        place = min(_somewhere(data, rng), len(array) - 1)
        array[place] ^= 1 << int(rng.integers(8))
    return array.tobytes()


def _set_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    at, length = _somewhere(data, rng), int(rng.integers(1, 9))
    filling = bytes([rng.choice(_BYTES)]) * length
    return data[:at] + filling + data[at + length :]


def _cut_off(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _somewhere(data, rng)]


def _take_out(data: bytes, rng: np.random.Generator) -> bytes:
    at = _somewhere(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 200)) :]


def _put_in(data: bytes, rng: np.random.Generator) -> bytes:
    at = _somewhere(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, 200))) + data[at:]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    at = _somewhere(data, rng)
    piece = data[at : at + int(rng.integers(1, 300))]
    return data[:at] + piece * int(rng.integers(2, 20)) + data[at:]


def _move(data: bytes, rng: np.random.Generator) -> bytes:
    one, other, length = _somewhere(data, rng), _somewhere(data, rng), int(rng.integers(1, 300))
    piece, rest = data[one : one + length], data[:one] + data[one + length :]
    return rest[:other] + piece + rest[other:]


def _other_number(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace(data, _NUMBER, _NUMBERS, rng)


def _other_word(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace(data, _WORD, _WORDS, rng)


def _nest(data: bytes, rng: np.random.Generator) -> bytes:
    at, depth = _somewhere(data, rng), int(rng.choice([3, 100, 5000]))
    opening = (b"[", b'{"a":', b"<a>", b"- ", b"(")[rng.integers(5)]
    return data[:at] + opening * depth + data[at:]


def _swap_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    one, other = rng.integers(len(lines), size=2)
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _replace(
    data: bytes, pattern: re.Pattern[bytes], by: tuple[bytes, ...], rng: np.random.Generator
) -> bytes:
    found = list(pattern.finditer(data, 0, min(len(data), 20_000)))
    if not found:
        return data
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + by[rng.integers(len(by))] + data[match.end() :]


_DAMAGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _flip_bits, _set_bytes, _cut_off, _take_out, _put_in, _repeat, _move, _other_number,
    _other_number, _other_number, _other_word, _other_word, _nest, _swap_lines,
)  # fmt: skip
