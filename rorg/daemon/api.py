"""The API, version 1: routes over the robot. FastAPI says what they take and give; nothing is decided here."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import FastAPI, Path, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from rorg import __version__
from rorg.daemon.api_common import Requester, Who, needs
from rorg.daemon.api_events import add_events
from rorg.daemon.api_manifests import add_manifests
from rorg.daemon.api_models import (
    ConfirmBody,
    GroupView,
    Held,
    HoldBody,
    Listener,
    Problem,
    PutRequest,
    RequestView,
    ServiceView,
    Usage,
    WaitResult,
    Why,
)
from rorg.daemon.not_before import GENERATION
from rorg.daemon.problems import answer, problem
from rorg.daemon.readiness import Question
from rorg.daemon.rights import Caller
from rorg.daemon.robot import Robot
from rorg.errors import Invalid, NotReady, RorgError
from rorg.model.catalog import Request as Ask
from rorg.model.units import parse_duration

SEEN = 5.0
"""Seconds until a service that asks is seen to run."""
MOST_BODY = 1 << 20
"""Bytes of a request's body."""
RESPONSES: dict[int | str, dict[str, Any]] = {
    code: {"model": Problem, "description": what, "content": {"application/problem+json": {}}}
    for code, what in ((400, "no JSON"), (403, "may not"), (404, "no such thing"), (409, "refused"), (413, "too large"),
                       (422, "invalid"), (503, "not now"), (504, "not ready"))}


def accepted(generation: int, body: dict[str, Any] | None = None) -> Response:
    """The answer to a change: its generation, and what there is to say."""
    headers = {GENERATION: str(generation)}
    if body is None:
        return Response(status_code=204, headers=headers)
    return JSONResponse({**body, "generation": generation}, headers=headers)


Id = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]


def make_app(robot: Robot, changed: Callable[[], asyncio.Event]) -> FastAPI:
    """The application. `changed()` is an event that is set at the next pass of the loop, or line of the journal."""
    app = FastAPI(title="rorg", version=__version__, docs_url=None, redoc_url=None, openapi_url="/v1/openapi.json",
                  responses=RESPONSES)
    app.state.robot = robot
    _errors(app)
    _reading(app, robot)
    _requests(app, robot, changed)
    _people(app, robot)
    _waiting(app, robot, changed)
    add_events(app, robot, changed)
    add_manifests(app, robot, changed)
    return app


def _errors(app: FastAPI) -> None:
    @app.exception_handler(RorgError)
    async def told(request: Request, error: RorgError) -> JSONResponse:
        return answer(error)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"] if p not in ("body", "query", "path"))
        return problem(422, "invalid", "cannot read the request", f"{where or 'body'}: {first['msg']}")

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        code = {404: "not-found", 405: "no-such-method"}.get(error.status_code, "invalid")
        found = problem(error.status_code, code, f"cannot {request.method} {request.url.path}", str(error.detail))
        found.headers.update(error.headers or {})
        return found

    @app.exception_handler(Exception)
    async def bug(request: Request, error: Exception) -> JSONResponse:
        return problem(500, "internal", f"cannot {request.method} {request.url.path}",
                       f"{type(error).__name__}: {error}", "to report this bug")

    app.add_middleware(_Bounded)


class _Bounded:
    """Refuses a body that is too large, or does not say how large it is, before any of it is read."""

    def __init__(self, app: Any) -> None:
        self.app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        headers = dict(scope.get("headers", ()))
        length = headers.get(b"content-length", b"0")
        if b"transfer-encoding" in headers or not length.isdigit() or int(length) > MOST_BODY:
            await problem(413, "too-large", "cannot read the request", f"its body may have {MOST_BODY} bytes, and must "
                          "say how many")(scope, receive, send)
        else:
            await self.app(scope, receive, send)


def _reading(app: FastAPI, robot: Robot) -> None:
    read = [needs("read")]

    def text(value: Any) -> Response:
        return Response(json.dumps(value), media_type="application/json")

    @app.get("/v1/services", dependencies=read, response_model=list[ServiceView])
    async def services() -> Response:
        """How every service is."""
        return Response(b"[" + b",".join(robot.service_text(n) for n in robot.statuses()) + b"]",
                        media_type="application/json")

    @app.get("/v1/services/{name}", dependencies=read, response_model=ServiceView)
    async def service(name: str) -> Response:
        """How one service is."""
        return Response(robot.service_text(name), media_type="application/json")

    @app.get("/v1/services/{name}/why", dependencies=read, response_model=list[Why])
    async def why(name: str) -> Response:
        """Why a service, or each of a group, is active, or why not."""
        return text([robot.why(n) for n in robot.members(name)])

    @app.get("/v1/groups", dependencies=read, response_model=list[GroupView])
    async def groups() -> Response:
        return text([{"name": g.name, "services": list(g.services), "description": g.description}
                     for g in robot.catalog.groups.values()])

    @app.get("/v1/images", dependencies=read, response_model=list[dict[str, Any]])
    async def images() -> Response:
        return text([{"name": i.name, "context": i.context, "dockerfile": i.dockerfile}
                     for i in robot.catalog.images.values()])

    @app.get("/v1/requests", dependencies=read, response_model=list[RequestView])
    async def requests() -> Response:
        """All requests that count, standing ones included."""
        return text(robot.requests())

    @app.get("/v1/status", dependencies=[needs("plan")], response_model=dict[str, Any])
    async def status() -> Response:
        """Everything at once: the tree, the engine, requests, pressure, the plan, all services."""
        return text(robot.snapshot())

    @app.get("/v1/plan", dependencies=[needs("plan")], response_model=dict[str, Any])
    async def plan() -> Response:
        """What is to be done, and what waits for what."""
        return text(robot.decision.plan.as_json())

    @app.get("/v1/listeners/{port}", dependencies=read, response_model=Listener)
    def listener(port: Annotated[int, Path(ge=1, le=65535)]) -> Response:
        """Which service listens at a TCP port of this machine: tells a bridge whose program calls it."""
        return text({"port": port, "service": robot.listener(port)})

    @app.get("/v1/usage", dependencies=read, response_model=Usage)
    def usage() -> Response:
        """CPU seconds and memory of each service that runs, and of the machine."""
        return text(robot.usage())


async def _seen(robot: Robot, caller: Caller, changed: Callable[[], asyncio.Event]) -> None:
    """A program may ask so soon after its start that the loop has not seen it run: that is waited for."""
    end = asyncio.get_running_loop().time() + SEEN
    while caller.kind == "service" and not robot.runs(caller.service):
        left = end - asyncio.get_running_loop().time()
        if left <= 0:
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(changed().wait(), left)


def _requests(app: FastAPI, robot: Robot, changed: Callable[[], asyncio.Event]) -> None:
    request = [needs("request")]

    @app.put("/v1/requests/{id}", dependencies=request, response_model=RequestView)
    async def put(id: Id, body: PutRequest, caller: Who, requester: Requester = None) -> Response:
        """Request services, in place of an earlier request of the same id. Durable when answered."""
        ask = Ask(id, requester or caller.requester, tuple(dict.fromkeys(body.services)), body.reason,
                  priority=body.priority, ttl=duration(body.ttl, "ttl") or None)
        await _seen(robot, caller, changed)
        return accepted(await asyncio.wrap_future(robot.put_request(caller, ask)), {
            "id": id, "requester": ask.requester, "services": list(ask.services), "reason": ask.reason,
            "priority": ask.priority, "ttl": ask.ttl})

    @app.post("/v1/requests/{id}/renew", dependencies=request, response_model=RequestView)
    async def renew(id: Id, caller: Who, requester: Requester = None) -> Response:
        """Give the lease of a request its full time again."""
        return JSONResponse(robot.renew(caller, (requester or caller.requester, id)))

    @app.delete("/v1/requests/{id}", dependencies=request, status_code=204, response_class=Response)
    async def release(id: Id, caller: Who, requester: Requester = None) -> Response:
        """Give a request up. What is released already is fine."""
        return accepted(await asyncio.wrap_future(robot.release(caller, (requester or caller.requester, id))))


def _people(app: FastAPI, robot: Robot) -> None:
    @app.post("/v1/services/{name}/restart", dependencies=[needs("restart")], response_model=Held)
    async def restart(name: str, caller: Who, force: bool = False, requester: Requester = None) -> Response:
        """Stop and start a service, or each of a group. Drivers only with `force`."""
        generation = await asyncio.wrap_future(robot.restart(caller, name, force))
        return accepted(generation, {"services": list(robot.members(name))})

    @app.put("/v1/holds/{name}", dependencies=[needs("hold")], response_model=Held)
    async def hold(name: str, body: HoldBody, caller: Who) -> Response:
        """Keep a service, or a group's, from being active for a time, whoever requests it."""
        generation = await asyncio.wrap_future(
            robot.hold(caller, name, duration(body.duration, "duration"), body.reason))
        return accepted(generation, {"services": list(robot.members(name))})

    @app.delete("/v1/holds/{name}", dependencies=[needs("hold")], status_code=204, response_class=Response)
    async def unhold(name: str, caller: Who) -> Response:
        return accepted(await asyncio.wrap_future(robot.hold(caller, name, None, "")))

    @app.put("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def suspend(body: HoldBody, caller: Who) -> Response:
        """Change nothing for a time."""
        return accepted(await asyncio.wrap_future(
            robot.suspend(caller, duration(body.duration, "duration"), body.reason)))

    @app.delete("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def unsuspend(caller: Who) -> Response:
        return accepted(await asyncio.wrap_future(robot.suspend(caller, None, "")))


    @app.put("/v1/removals", dependencies=[needs("removals")], status_code=204, response_class=Response)
    async def confirm(body: ConfirmBody, caller: Who) -> Response:
        """Confirm that what no manifest declares any more is removed, though a request, a need or a group named it."""
        return accepted(await asyncio.wrap_future(robot.confirm(caller, tuple(body.services))))


def duration(value: str | None, field: str) -> float:
    try:
        seconds = parse_duration(value) if value is not None else 0.0
    except ValueError as error:
        raise Invalid("read the request", f"{field}: {error}") from error
    if value is not None and not seconds:
        raise Invalid("read the request", f"{field}: must be more than 0", "10s, for instance")
    return seconds


async def gone(request: Request) -> None:
    """Returns when the caller has closed the connection."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def _ready(robot: Robot, question: Question, timeout: float, changed: Callable[[], asyncio.Event],
                 hangup: asyncio.Future[None]) -> Response:
    clock = asyncio.get_running_loop().time
    deadline = clock() + timeout
    while not hangup.done():
        event = changed()
        known = robot.open_to(question.generation)
        found = robot.readiness(question)
        services = {name: ready.as_json() for name, ready in found.services.items()}
        left = deadline - clock()
        if known and found.ready:
            return JSONResponse({"ready": True, "services": services})
        if (known and found.hopeless) or left <= 0:
            raise NotReady(f"wait for {', '.join(question.names)}", found.reason or "the loop is busy",
                           "`rorg why` for the reasons", services)
        news = asyncio.ensure_future(event.wait())
        await asyncio.wait((news, hangup), timeout=left, return_when=asyncio.FIRST_COMPLETED)
        news.cancel()
    return Response(status_code=400)  # nobody reads it


def _waiting(app: FastAPI, robot: Robot, changed: Callable[[], asyncio.Event]) -> None:
    @app.get("/v1/wait", dependencies=[needs("read")], response_model=WaitResult)
    async def wait(request: Request, services: Annotated[list[str], Query(min_length=1, max_length=300)],
                   timeout: Annotated[float, Query(ge=0, le=3600)] = 30.0) -> Response:
        """Answers when these services and all that they need are ready: wanted, running, their readiness told by this
        run since the question was asked, and nothing under way that ends it. Every change that was accepted before
        counts. With the reason when they do not get so."""
        names = tuple(dict.fromkeys(m for s in services for m in robot.members(s)))
        with robot.question(names) as question:
            hangup = asyncio.ensure_future(gone(request))
            try:
                return await _ready(robot, question, timeout, changed, hangup)
            finally:
                hangup.cancel()
