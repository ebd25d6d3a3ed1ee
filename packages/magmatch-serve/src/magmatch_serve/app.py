# SPDX-License-Identifier: BSD-3-Clause
"""Each path of the service answers one question."""

import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from magmatch_serve.bodies import checkpoints
from magmatch_serve.gate import Gate
from magmatch_serve.live import PROTOCOL, Live, close
from magmatch_serve.logs.uploads import receive_log
from magmatch_serve.logs.work import Verb, read_question, work_on_log, work_on_sent_log
from magmatch_serve.metrics import CONTENT_TYPE
from magmatch_serve.openapi import openapi, openapi_page
from magmatch_serve.refusals import RefusedError
from magmatch_serve.service import Service

log = logging.getLogger("magmatch.serve")
PAGE = files("magmatch_serve") / "page"
WORDS = {404: "nothing is at this path; /docs lists what is", 405: "this path takes another method; see /docs"}


def build_app(service: Service) -> Starlette:
    """Put paths and answers together."""
    app = Starlette(
        routes=[
            Route("/", _file("page.html", "text/html"), methods=["GET"]),
            Route("/page.js", _file("page.js", "text/javascript"), methods=["GET"]),
            Route("/page.css", _file("page.css", "text/css"), methods=["GET"]),
            Route("/docs", lambda _: HTMLResponse(openapi_page()), methods=["GET"]),
            Route("/openapi.json", lambda _: JSONResponse(openapi()), methods=["GET"]),
            Route("/health", partial(_health, service), methods=["GET"]),
            Route("/metrics", partial(_metrics, service), methods=["GET"]),
            Route("/maps", lambda _: JSONResponse(service.catalogue.document()), methods=["GET"]),
            Route("/maps/{name}", partial(_picture, service), methods=["GET"]),
            Route("/localize", partial(_log, service, "localize"), methods=["POST"]),
            Route("/register", partial(_log, service, "register"), methods=["POST"]),
            WebSocketRoute("/live", partial(_admit, service, _live)),
            WebSocketRoute("/watch", partial(_admit, service, _watch)),
            WebSocketRoute("/{path:path}", partial(_nowhere, service)),
        ],
        middleware=[Middleware(Gate, config=service.config, metrics=service.metrics)],
        exception_handlers=dict.fromkeys((RefusedError, HTTPException, 500), partial(_explain, service)),
    )
    # A path with a slash too many is another path.
    app.router.redirect_slashes = False
    return app


async def _health(service: Service, _: Request) -> Response:
    said = service.health()
    return JSONResponse(said, 200 if said["status"] == "well" else 503)


async def _metrics(service: Service, _: Request) -> Response:
    return Response(service.metrics.text(), headers={"Content-Type": CONTENT_TYPE})


async def _picture(service: Service, request: Request) -> Response:
    return JSONResponse(await service.picture(request.path_params["name"]))


async def _log(service: Service, verb: Verb, request: Request) -> Response:
    """Let a worker answer a question of a log."""
    question = read_question(verb, request.query_params.multi_items())
    served, logs = service.catalogue.served, service.workers
    try:
        with logs.room(), TemporaryDirectory(prefix=checkpoints.UPLOAD, dir=service.config.states) as folder:
            upload = Path(folder) / "log"
            await receive_log(request, upload, service.config)
            # A cluster does not see this folder, and nobody's token is its business.
            is_here = service.config.dask is None
            work, sent = (work_on_log, upload) if is_here else (work_on_sent_log, upload.read_bytes())
            config = service.config.model_copy(update={"token": None})
            document = await logs.run(work, service.place, served, sent, question, config)
    except OSError as error:
        log.warning("a log that was sent could not be kept: %s", error)
        raise RefusedError(503, "the service cannot write the log to its disk; send it later", 30) from None
    service.metrics.logs.labels(verb).inc()
    return JSONResponse(document)


async def _admit(
    service: Service, follow: Callable[[Service, WebSocket], Awaitable[None]], socket: WebSocket
) -> None:
    """Follow a socket; one of the places for clients is held as long."""
    try:
        service.enter()
    except RefusedError as refused:
        await socket.send_denial_response(_refusal(service, refused))
        return
    try:
        # Ours, where it is offered: the token beside it is not said back.
        await socket.accept(PROTOCOL if PROTOCOL in socket.scope.get("subprotocols", []) else None)
        await follow(service, socket)
    except (WebSocketDisconnect, RuntimeError):  # it left while something was sent
        pass
    finally:
        service.leave()


async def _nowhere(service: Service, socket: WebSocket) -> None:
    await socket.send_denial_response(_refusal(service, RefusedError(404, WORDS[404])))


async def _explain(service: Service, _: Request, error: Exception) -> Response:
    """A refusal for whatever went wrong; the server logs what is its own fault."""
    if isinstance(error, RefusedError):
        return _refusal(service, error)
    if not isinstance(error, HTTPException):
        return _refusal(service, RefusedError(500, "the service made a mistake; please report it"))
    answer = _refusal(service, RefusedError(error.status_code, WORDS.get(error.status_code, error.detail)))
    answer.headers.update(error.headers or {})
    return answer


async def _live(service: Service, socket: WebSocket) -> None:
    """Follow one client."""
    one = Live(socket, service.config, service.metrics)
    try:
        said = await one.hello()
        if one.client in service.connected:
            service.connected[one.client].replace()
        service.connected[one.client] = one
        await one.follow(service.trackers.of(one.client), said)
    except RefusedError as refused:
        service.metrics.refused.labels(refused.status).inc()
        await close(socket, refused)
    finally:
        if service.connected.get(one.client) is one:
            del service.connected[one.client]


async def _watch(service: Service, socket: WebSocket) -> None:
    """Send pictures until whoever watches leaves."""
    with suppress(RefusedError):
        async with service.watched() as pictures:
            while True:
                await socket.send_text(await pictures.get())


def _refusal(service: Service, refused: RefusedError) -> Response:
    service.metrics.refused.labels(refused.status).inc()
    return JSONResponse(refused.document, refused.status, refused.headers)


def _file(name: str, kind: str):  # type: ignore[no-untyped-def]
    content = (PAGE / name).read_bytes()

    async def answer(_: Request) -> Response:
        return Response(content, media_type=kind)

    return answer
