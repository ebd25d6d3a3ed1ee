# SPDX-License-Identifier: BSD-3-Clause
"""Every request and connection is asked whether it may come in, before anything else is done."""

import secrets
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from magmatch_serve.allowance import Allowances
from magmatch_serve.config import LOOPBACK, ServeConfig
from magmatch_serve.metrics import Metrics
from magmatch_serve.refusals import RefusedError

# Without data of anybody: the page that asks for the token, and whether the service is well.
OPEN = {"/", "/page.js", "/page.css", "/health", "/docs", "/openapi.json"}
BEARER = "bearer."
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Gate:
    """Checks in this order: Host, Origin, how often, token."""

    def __init__(self, app: ASGIApp, config: ServeConfig, metrics: Metrics) -> None:
        self._app, self._config, self._metrics = app, config, metrics
        self._requests, self._connects = Allowances(config.max_requests), Allowances(config.max_connects)
        named = {urlsplit(one).hostname or "" for one in config.origins}
        # A page from elsewhere may have its own name lead to this machine.
        self._hosts = None if config.token is not None else {*LOOPBACK, *named}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let in, or answer with a refusal."""
        is_http = scope["type"] == "http"

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message.get("headers", []), *((k.lower().encode(), v.encode()) for k, v in HEADERS.items())
                ]  # fmt: skip
            await send(message)

        try:
            self._check(scope, Headers(scope=scope), is_http=is_http)
        except RefusedError as refused:
            self._metrics.refused.labels(refused.status).inc()
            if is_http or "websocket.http.response" in scope.get("extensions", {}):
                answer = JSONResponse(refused.document, refused.status, refused.headers)
                await answer(scope, receive, send_guarded if is_http else send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": ""})
            return
        await self._app(scope, receive, send_guarded if is_http else send)

    def _check(self, scope: Scope, headers: Headers, *, is_http: bool) -> None:
        host, origins = headers.get("host", ""), headers.getlist("origin")
        if self._hosts is not None and _name(host) not in self._hosts:
            raise RefusedError(421, f"Host: expected the name of this machine's loopback, found '{host[:60]}'")
        for origin in origins:
            # Pages that this service sent, at whichever of its names, are its own.
            if origin not in {*self._config.origins, f"http://{host}", f"https://{host}"}:
                raise RefusedError(403, f"Origin: pages of '{origin[:60]}' may not ask this service")
        address = (scope.get("client") or ("", 0))[0]
        wait = (self._requests if is_http else self._connects).take(address)
        if wait > 0:
            raise RefusedError(429, "more requests than this address may make; try again later", retry_after=wait)
        if self._config.token is not None and not (is_http and scope["path"] in OPEN):
            self._check_token(headers, self._config.token)

    def _check_token(self, headers: Headers, token: str) -> None:
        kind, _, said = headers.get("authorization", "").partition(" ")
        if kind.lower() != "bearer":
            # A page cannot set headers of a WebSocket.
            offered = [one.strip() for one in headers.get("sec-websocket-protocol", "").split(",")]
            said = next((one.removeprefix(BEARER) for one in offered if one.startswith(BEARER)), "")
        if not said:
            raise RefusedError(401, "expected 'Authorization: Bearer TOKEN', found none")
        if not secrets.compare_digest(said.strip().encode(), token.encode()):
            raise RefusedError(401, "the token is not that of this service")


def _name(host: str) -> str:
    """Host without its port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
