"""Download of one file over HTTP: streamed, resumed where it broke off, retried a limited number of
times."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import httpx

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.atomic import unwritable
from pointsdf_cli.io.provenance import file_sha256


@dataclass(frozen=True)
class Patience:
    """Limits of the attempts.

    Attributes:
        attempts: Largest number of tries without a received byte.
        first_wait: Time before the second try [s]; doubled each time.
        longest_wait: Largest time between two tries [s].
        timeout: Time without a received byte after which a try has failed [s].
        largest: Largest size of the file in bytes.
    """

    attempts: int = 5
    first_wait: float = 1.0
    longest_wait: float = 30.0
    timeout: float = 30.0
    largest: int = 1024**3

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise InputError(f"{self.attempts} attempts", where="attempts", allowed="1 or more")


class _Broken(Exception):
    """Failure of a try that may succeed when repeated."""


def download(url: str, path: Path, patience: Patience | None = None) -> str:
    """Fetch `url` into `path` and return the SHA-256 of the whole file.

    The received part is in `path` + `.part`, also after a kill, and the next call fetches only the
    rest. The file is resumed only if the server still has the same version (by its entity tag or
    date), else fetched from the start.

    Raises:
        InputError: The server has no such file, the file is too large, or the disk cannot hold it.
        RgraspError: The server cannot be reached, or breaks off every time.
    """
    patience = patience or Patience()
    part, tag = path.with_name(path.name + ".part"), path.with_name(path.name + ".tag")
    failures = 0
    with httpx.Client(timeout=patience.timeout, follow_redirects=True) as client:
        while True:
            before = _size(part)
            try:
                _fetch_rest(client, url, part, tag, patience.largest)
                break
            except (httpx.InvalidURL, httpx.UnsupportedProtocol, httpx.TooManyRedirects) as error:
                raise InputError(f"cannot be fetched from ({error})", where=url) from error
            except (_Broken, httpx.TransportError) as error:
                failures = 1 if _size(part) > before else failures + 1
                if failures >= patience.attempts:
                    raise RgraspError(
                        f"cannot be fetched ({type(error).__name__}: {error})",
                        where=url,
                        hint="check the connection and run the same command again: it resumes",
                    ) from error
                time.sleep(min(patience.first_wait * 2 ** (failures - 1), patience.longest_wait))
            except OSError as error:
                raise unwritable(path, error) from error
    digest = file_sha256(part)
    part.replace(path)
    tag.unlink(missing_ok=True)
    return digest


def _fetch_rest(client: httpx.Client, url: str, part: Path, tag: Path, largest: int) -> None:
    """Append the missing bytes to `part`, which is complete when this returns."""
    have = _size(part)
    validator = tag.read_text(encoding="ascii") if have and tag.exists() else ""
    headers = {"Accept-Encoding": "identity"}
    if validator:
        headers |= {"Range": f"bytes={have}-", "If-Range": validator}
    with client.stream("GET", url, headers=headers) as response:
        if response.status_code == 416 and validator:
            # Nothing is left to send, or the file became shorter: start from the beginning.
            tag.unlink()
            raise _Broken("the part does not fit the file any more")
        if response.status_code in (403, 404, 410):
            raise InputError(f"the server has no such file ({response.status_code})", where=url)
        if response.status_code not in (200, 206):
            raise _Broken(f"HTTP status {response.status_code}")
        resumes = response.status_code == 206
        if resumes and not response.headers.get("Content-Range", "").startswith(f"bytes {have}-"):
            tag.unlink(missing_ok=True)
            raise _Broken("the server sent another part than asked for")
        written = have if resumes else 0
        expected = written + int(response.headers.get("Content-Length", 0))
        if expected > largest:
            raise InputError(f"{expected} bytes", where=url, allowed=f"at most {largest}")
        if not resumes:
            tag.unlink(missing_ok=True)  # a kill here must not leave the old part with the new tag
        with open(part, "ab" if resumes else "wb") as file:
            _remember(tag, response.headers)
            for block in response.iter_raw():
                written += len(block)
                if written > largest:
                    allowed = f"{largest} bytes"
                    raise InputError("is larger than allowed", where=url, allowed=allowed)
                file.write(block)
        if "Content-Length" in response.headers and written != expected:
            raise _Broken(f"{written} bytes of {expected}")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _remember(tag: Path, headers: httpx.Headers) -> None:
    """Keep what identifies this version of the file; a weak entity tag does not."""
    entity = headers.get("ETag", "")
    strong = entity and not entity.startswith("W/")
    validator = entity if strong else headers.get("Last-Modified", "")
    if validator:
        tag.write_text(validator, encoding="ascii")
    else:
        tag.unlink(missing_ok=True)
