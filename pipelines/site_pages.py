"""Hook of mkdocs.yml: README as the first page, and links to files outside docs/ as plain text.

The pages are written for a repository's browser. The site lacks the repository's other files, so a
link to one becomes its text, after a check that the file is there.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)[^)#\s]*)(?:#[^)]*)?\)")
README_LINK = re.compile(r"\]\((?!\w+:|#)(?:docs/)?([^)\s]+)\)")
FENCE = re.compile(r"^```(\w+) .*$", re.MULTILINE)
log = logging.getLogger("mkdocs.hooks.site_pages")


def on_files(files: Files, config: Any) -> Files:
    """Add README as index.md, its links as seen from docs/."""
    text = README_LINK.sub(_from_docs, (ROOT / "README.md").read_text(encoding="utf-8"))
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Drop what only the tests read after a fence's language, and unlink files outside docs/."""

    def unlinked(match: re.Match[str]) -> str:
        there = (ROOT / "docs" / page.file.src_uri).parent / match[2]
        if not there.exists():
            log.warning("%s links to %s, which does not exist", page.file.src_uri, match[2])
        return match[1]

    return LINK.sub(unlinked, FENCE.sub(r"```\1", markdown))


def _from_docs(match: re.Match[str]) -> str:
    inside = match[0].startswith("](docs/")
    return f"]({'' if inside else '../'}{match[1]})"
