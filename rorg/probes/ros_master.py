"""Asks a ROS 1 master for its graph by XML-RPC: 1-2 ms for each question, without ROS installed (`rosnode ping`: 1.2
s).

Every answer of a master is [code, message, value]; code 1 means success. Any program that listens at its port, or at an
address that it names, may answer anything, or for ever.
"""

from __future__ import annotations

import xmlrpc.client
from http.client import HTTPResponse
from typing import Any, NoReturn
from xml.parsers import expat

from rorg.host.bounded_http import answer, connect, place_of
from rorg.host.deadline import Deadline
from rorg.probes.answer import YES, Answer, no

CALLER = "/rorg"
TIMEOUT = 1.0
"""Seconds for one attempt with all its calls. A paused program accepts the connection and never answers."""
MOST = 2 << 20
"""Bytes of one answer. The graph of 300 nodes with 1,000 topics has some 0.7 MiB."""
CHUNK = 1 << 16
Graph = list[dict[str, list[str]]]
"""Publishers, subscribers and services: by topic or service, the names of nodes."""


def call(uri: str, method: str, *args: Any, deadline: Deadline | None = None) -> Any:
    """The value of a successful call. Raises OSError if nothing answers, or something that is not ROS; LookupError if
    the answer is no."""
    return value_of(ask(uri, method, *args, deadline=deadline))


def ask(uri: str, method: str, *args: Any, deadline: Deadline | None = None) -> Any:
    """The result of an XML-RPC call, which need not be an answer of ROS. Raises OSError."""
    deadline, asked = deadline or Deadline.within(TIMEOUT), xmlrpc.client.dumps(args, method).encode()
    with answer(uri, deadline, MOST, asked, {"Content-Type": "text/xml"}) as response:
        if response.status != 200:
            raise OSError(f"it answers {response.status}")
        return _parsed(response, deadline)


def value_of(reply: Any) -> Any:
    """The value of a successful answer. Raises OSError if it is not an answer of ROS; LookupError if it is no."""
    if not (isinstance(reply, list) and len(reply) == 3):
        raise OSError("its answer is not that of ROS")
    code, message, value = reply
    if code != 1:
        raise LookupError(str(message)[:200])
    return value


def _parsed(response: HTTPResponse, deadline: Deadline) -> Any:
    """The value of an answer, parsed as it comes. It may not declare entities, since a few lines of them make
    gigabytes. Raises OSError."""
    target, parser = xmlrpc.client.Unmarshaller(), expat.ParserCreate()
    target.xml("", None)  # expat has decoded the text
    parser.StartElementHandler, parser.EndElementHandler = target.start, target.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = target.data, _refuse
    try:
        while chunk := response.read1(CHUNK):
            parser.Parse(chunk, False)
            deadline.left()
        parser.Parse(b"", True)
        return target.close()[0]
    except OSError:
        raise
    except Exception as error:  # xmlrpc assumes a well-formed answer, and breaks in many ways on others
        raise OSError(f"{type(error).__name__}: {str(error)[:200]}") from error


def _refuse(*_: Any) -> NoReturn:
    raise OSError("its answer declares a document type")


def graph(master: str, deadline: Deadline) -> Graph:
    """Publishers, subscribers and services. Raises OSError."""
    try:
        state = call(master, "getSystemState", CALLER, deadline=deadline)
        parts = [{str(name): [str(node) for node in nodes] for name, nodes in part} for part in state]
    except (TypeError, ValueError, LookupError) as error:
        raise OSError("its answer is not that of a ROS master") from error
    if len(parts) != 3:
        raise OSError("its answer is not that of a ROS master")
    return parts


def probe(kind: str, name: str, master: str) -> Answer:
    """Whether a node, topic, service, action or parameter is there. `kind` is one of ROS_KINDS that a master of ROS 1
    can answer."""
    deadline = Deadline.within(TIMEOUT)
    try:
        if kind == "ros_topic":
            return YES if name in graph(master, deadline)[0] else no(f"{name} has no publisher")
        if kind == "ros_action":  # a server of actionlib publishes this topic; there is no other sign of it
            return YES if f"{name}/status" in graph(master, deadline)[0] else no(f"{name} has no action server")
        if kind == "ros_parameter":
            return YES if call(master, "hasParam", CALLER, name, deadline=deadline) else no(f"{name} is not set")
        question = "lookupService" if kind == "ros_service" else "lookupNode"
        where = str(call(master, question, CALLER, name, deadline=deadline))
    except LookupError:
        return no(f"{name} is not registered")
    except OSError as error:
        return no(f"the ROS master {master} does not answer: {error.strerror or error}")
    try:
        if kind == "ros_service":
            connect(*place_of(where, "rosrpc"), deadline).close()
        else:
            call(where, "getPid", CALLER, deadline=deadline)
    except (OSError, LookupError) as error:
        return no(f"{name} does not answer: {getattr(error, 'strerror', None) or error}")
    return YES
