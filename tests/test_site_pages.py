"""The site of the documentation: every public name has its entry, and lost files are noticed.

Whether the site builds without a warning is `make docs`'s to say.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

import pointsdf_cli

REPOSITORY = Path(__file__).resolve().parents[1]


def test_every_public_name_has_an_entry() -> None:
    pages = "".join(page.read_text() for page in (REPOSITORY / "docs" / "api").glob("*.md"))
    entries = set(re.findall(r"^::: pointsdf_cli\.(\w+)$", pages, re.MULTILINE))
    assert entries == set(pointsdf_cli._HOMES)


def test_links_out_of_the_site_become_text_and_lost_files_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("mkdocs", reason="mkdocs is not installed")
    monkeypatch.syspath_prepend(REPOSITORY / "pipelines")
    import site_pages

    page = SimpleNamespace(file=SimpleNamespace(src_uri="api/index.md"))
    text = "```sh run count=3\n[the licence](../../LICENSE) [a](clouds.md)\n"
    with caplog.at_level(logging.WARNING):
        told = site_pages.on_page_markdown(text, page)
        assert told == "```sh\nthe licence [a](clouds.md)\n"
        assert not caplog.records
        site_pages.on_page_markdown("[gone](../../no_such_file.md)", page)
    assert "no_such_file.md" in caplog.text
