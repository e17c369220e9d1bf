"""Connections that are closed when their other end keeps them waiting.

uvicorn waits for ever for a request's first lines and for an answer to be read. The server takes a
bounded number of connections, so that a few dozen idle ones, of anybody who reaches the port, would
keep everyone else out.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

SLOWEST_HEAD = 10.0
"""Seconds in which the head of a request must arrive, from its connection or its first byte on."""

SLOWEST_READER = 60.0
"""Seconds in which some of a waiting answer must be read."""

_Protocol: Any = AutoHTTPProtocol


class PunctualProtocol(_Protocol):
    """uvicorn's protocol of one connection, with deadlines."""

    _head: asyncio.TimerHandle | None = None
    _reader: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Start the deadline for a request's head."""
        super().connection_made(transport)
        self._expect_head()

    def data_received(self, data: bytes) -> None:
        """Start the deadline for a request's head, or stop it when the head is complete; further
        bytes do not extend it."""
        super().data_received(data)
        self._expect_head()

    def pause_writing(self) -> None:
        """Start the deadline for reading: the system's buffers are full of the answer."""
        super().pause_writing()
        self._reader = self.loop.call_later(SLOWEST_READER, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the deadline for reading: some of the answer was read."""
        _cancel(self._reader)
        super().resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        """Stop all deadlines."""
        _cancel(self._head)
        _cancel(self._reader)
        super().connection_lost(error)

    def _expect_head(self) -> None:
        if self._is_answering():
            _cancel(self._head)
            self._head = None
        elif self._head is None:
            self._head = self.loop.call_later(SLOWEST_HEAD, self._close_unless_answering)

    def _close_unless_answering(self) -> None:
        self._head = None
        if not self._is_answering():
            self.transport.close()

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
