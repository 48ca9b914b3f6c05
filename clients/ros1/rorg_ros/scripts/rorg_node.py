#!/usr/bin/env python3
"""The ROS 1 node /rorg: services request, release, query, restart and manifests, and the latched topic status."""

import socket
import threading
import xmlrpc.client
from urllib.parse import urlparse

import rosgraph
import rospy
from rorg_client import Client, Error
from rorg_client.ros.bridge import Bridge
from rorg_client.ros.identity import Connection, Graph
from rorg_client.ros.notifications import serve
from rorg_ros.msg import ServiceStatus, Status
from rorg_ros.srv import (
    GetManifest,
    GetManifestResponse,
    PutManifest,
    PutManifestResponse,
    QueryService,
    QueryServiceResponse,
    ReleaseServices,
    ReleaseServicesResponse,
    RemoveManifest,
    RemoveManifestResponse,
    RequestServices,
    RequestServicesResponse,
    RestartService,
    RestartServiceResponse,
)
from std_msgs.msg import String


class Master(Graph):
    """The graph, as the ROS master knows it."""

    def alive(self, node):
        """Registered, and something listens at its port: true for a paused node, not for a killed one."""
        try:
            return listens(master().lookupNode(node))
        except rosgraph.MasterError:
            return False
        except (OSError, xmlrpc.client.Error):
            return True  # no master: nothing is known

    def near(self, node):
        return is_near(self._where(node)[0])

    def port(self, node):
        host, port = self._where(node)
        return port if is_near(host) else 0

    def _where(self, node):
        """(host, port) of its registration; ("", 0) without one, or without a master."""
        try:
            where = urlparse(master().lookupNode(node))
            return where.hostname or "", where.port or 0
        except (rosgraph.MasterError, OSError, ValueError, xmlrpc.client.Error):
            return "", 0

    def nodes(self):
        try:
            return {node for part in master().getSystemState() for _, nodes in part for node in nodes}
        except (rosgraph.MasterError, OSError, xmlrpc.client.Error):
            return set()


def master():
    return rosgraph.Master("/rorg")  # one for each call: a connection must not be shared by threads


def listens(uri):
    """Whether anything listens there: only a refused connection means no."""
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname or "", where.port or 0), timeout=1.0).close()
    except ConnectionRefusedError:
        return False
    except OSError:
        pass
    return True


def is_near(host):
    """Whether an address, or what a name stands for, is one of this machine (only then can it be bound); None if the
    name stands for nothing."""
    try:
        with socket.socket() as probe:
            probe.bind((host, 0))
        return True if host else None
    except socket.gaierror:
        return None
    except OSError:
        return False


class Service(rospy.Service):
    """Passes the connection of a call to its handler, in place of what the caller claims about itself."""

    def handle(self, transport, header):
        there, here = transport.socket.getpeername(), transport.socket.getsockname()
        near = is_near(there[0])
        header["connection"] = Connection(near, there[1] if near else 0, here[1])
        return super().handle(transport, header)


def caller(request) -> str:
    return request._connection_header["callerid"]


def via(request) -> Connection:
    return request._connection_header["connection"]


def status_of(service) -> ServiceStatus:
    return ServiceStatus(*(service[field] for field in ("service", "state", "health", "wanted", "why")))


def publish(client: Client) -> None:
    """Publishes the state of all services whenever it has changed."""
    publisher, last = rospy.Publisher("~status", Status, queue_size=1, latch=True), None
    while not rospy.is_shutdown():
        try:
            now = Status([status_of(s) for s in client.services() if s["state"] != "meta"])
            if now != last:
                publisher.publish(now)
                last = now
        except Error as error:
            rospy.logwarn_throttle(10, str(error))
        rospy.rostime.wallsleep(0.2)


def offer(bridge: Bridge) -> None:
    """Offers the ROS services of the bridge."""

    def query(request):
        found, message, service = bridge.query(request.name)
        return QueryServiceResponse(found, message, status_of(service) if found else ServiceStatus())

    Service("~query", QueryService, query)
    Service(
        "~request",
        RequestServices,
        lambda r: RequestServicesResponse(
            *bridge.request(caller(r), r.id, r.services, r.reason, r.wait, r.ttl, via(r))
        ),
    )
    Service(
        "~release", ReleaseServices, lambda r: ReleaseServicesResponse(*bridge.release(caller(r), r.id, via(r))[:2])
    )
    Service(
        "~restart",
        RestartService,
        lambda r: RestartServiceResponse(*bridge.restart(caller(r), r.name, r.force, via(r))[:2]),
    )
    Service(
        "~get_manifest",
        GetManifest,
        lambda r: GetManifestResponse(*bridge.get_manifest(caller(r), r.kind, r.name, via(r))),
    )
    Service(
        "~put_manifest",
        PutManifest,
        lambda r: PutManifestResponse(
            *bridge.put_manifest(caller(r), r.kind, r.name, r.text, r.base, r.message, via(r))
        ),
    )
    Service(
        "~remove_manifest",
        RemoveManifest,
        lambda r: RemoveManifestResponse(
            *bridge.remove_manifest(caller(r), r.kind, r.name, r.base, r.message, via(r))[:2]
        ),
    )


def main() -> None:
    rospy.init_node("rorg")
    bridge = Bridge(Client(), Master(), others=rospy.get_param("~others", ""))
    offer(bridge)
    threading.Thread(target=publish, args=(Client(),), daemon=True).start()
    if port := rospy.get_param("~notifications", 0):
        serve(port, rospy.Publisher("~notifications", String, queue_size=10).publish)
    while not rospy.is_shutdown():
        try:
            for name in bridge.sweep():
                rospy.loginfo(f"{name} is gone; what it held is released")
        except Error as error:
            rospy.logwarn_throttle(10, str(error))
        rospy.rostime.wallsleep(0.5)


if __name__ == "__main__":
    main()
