# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Web server of a live page: on this machine's loopback address only, behind a token in the page's address."""

from __future__ import annotations

import logging
import os
import secrets
from collections.abc import Callable
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import HTTPError, RequestHandler

from hyst_control.base.errors import InputError

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 32
HTTP_PORT = 80  # Port that browsers leave out of an address
REMEDY = "set --port to a free one, or leave it out"


class LiveServer:
    """Server of one page.

    Everything lies below the token: page, scripts and websocket. What is asked for without it is refused with status 403. A websocket is
    refused as well when another site's page asks for it, and when its session was not begun by this server. A request whose Host header
    is another than the page's address is refused too: a foreign name may be made to resolve to this machine.
    """

    def __init__(self, fill: Callable[[Document], None], port: int = 0) -> None:
        for variable in ("BOKEH_ALLOW_WS_ORIGIN", "BOKEH_RESOURCES", "BOKEH_LOG_LEVEL", "BOKEH_PY_LOG_LEVEL"):
            os.environ.pop(variable, None)  # which would replace what is set here
        logging.getLogger("bokeh").setLevel(logging.CRITICAL)
        logging.getLogger("tornado").setLevel(logging.CRITICAL)
        try:
            sockets, self.port = bind_sockets(LOOPBACK, port)
        except (OSError, OverflowError) as error:
            raise InputError(f"--port: {port}: {getattr(error, 'strerror', None) or error}: {REMEDY}") from None
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        tornado = _OwnHost(
            {"/": Application(FunctionHandler(fill))},
            prefix=self.token,
            extra_websocket_origins=[f"{LOOPBACK}:{self.port}"],
            secret_key=secrets.token_bytes(TOKEN_BYTES),
            sign_sessions=True,
            default_handler_class=_Forbidden,
        )
        tornado.hosts = frozenset({f"{LOOPBACK}:{self.port}"} | ({LOOPBACK} if self.port == HTTP_PORT else set()))
        http = HTTPServer(tornado)
        http.add_sockets(sockets)
        self._loop = IOLoop.current()
        self._server = BaseServer(self._loop, tornado, http)

    @property
    def url(self) -> str:
        """Address of the page, token included."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    def run(self) -> None:
        """Serve until `end` is called, or an exception such as KeyboardInterrupt ends it."""
        self._server.start()
        try:
            self._loop.start()
        finally:
            self._server.stop()

    def end(self) -> None:
        """End `run`; may be called from any thread."""
        self._loop.add_callback(self._loop.stop)


class _OwnHost(BokehTornado):
    """Application that answers to requests for its own address only."""

    hosts: frozenset[str] = frozenset()

    def find_handler(self, request: HTTPServerRequest, **options: Any) -> Any:
        if request.host in self.hosts:
            return super().find_handler(request, **options)
        return self.get_handler_delegate(request, _Forbidden)


class _Forbidden(RequestHandler):
    """Answer to everything that is asked for without the token."""

    def prepare(self) -> Any:
        raise HTTPError(403)
