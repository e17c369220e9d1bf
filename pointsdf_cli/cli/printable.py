"""Text from files and names as a terminal may show it.

A terminal obeys escape sequences: a file's attribute could clear the screen, rename the window or
print a line that rgrasp never said. Characters that change the writing direction hide what a name
is.
"""

from __future__ import annotations

import re

_CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_CONTROLS_OF_JSON = re.compile("[\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """Write control characters as backslash escapes; tabs and line ends stay."""
    return _CONTROLS.sub(_escaped, text)


def on_one_line(text: str) -> str:
    """Escape control characters, tabs and line ends: for a value within one line."""
    return printable(text).replace("\n", "\\n")


def printable_json(text: str) -> str:
    """Write the control characters that a JSON document may hold as JSON escapes."""
    return _CONTROLS_OF_JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _escaped(found: re.Match[str]) -> str:
    number = ord(found[0])
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}"
