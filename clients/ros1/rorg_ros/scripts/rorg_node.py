#!/usr/bin/env python3
"""The ROS 1 node /rorg: services request, release, query, restart and manifests, and the latched topic status."""

import socket
import threading
import xmlrpc.client
from urllib.parse import urlparse

import rosgraph
import rospy
from rorg_ros.bridge import Bridge, Client, Error, Graph
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


class Master(Graph):
    """The graph as the ROS master knows it."""

    def __init__(self) -> None:
        self.local = {"localhost", socket.gethostname(), *rosgraph.network.get_local_addresses()}

    def alive(self, node):
        """Registered, and somebody listens at its port: a paused node does, a killed one does not."""
        try:
            return listens(master().lookupNode(node))
        except rosgraph.MasterError:
            return False
        except (OSError, xmlrpc.client.Error):
            return True  # no master: nothing can be concluded

    def port(self, node):
        try:
            where = urlparse(master().lookupNode(node))
        except (rosgraph.MasterError, OSError, xmlrpc.client.Error):
            return 0
        return (where.port or 0) if where.hostname in self.local else 0

    def nodes(self):
        try:
            return {node for part in master().getSystemState() for _, nodes in part for node in nodes}
        except (rosgraph.MasterError, OSError, xmlrpc.client.Error):
            return set()


def master():
    return rosgraph.Master("/rorg")  # one for each call: a connection is not for several threads


def listens(uri):
    """Whether anybody is there: only a refused connection says no."""
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname or "", where.port or 0), timeout=1.0).close()
    except ConnectionRefusedError:
        return False
    except OSError:
        pass
    return True


def caller(request) -> str:
    return request._connection_header["callerid"]


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
    """Puts ROS services in front of the bridge."""

    def query(request):
        found, message, service = bridge.query(request.name)
        return QueryServiceResponse(found, message, status_of(service) if found else ServiceStatus())

    rospy.Service("~query", QueryService, query)
    rospy.Service(
        "~request",
        RequestServices,
        lambda r: RequestServicesResponse(*bridge.request(caller(r), r.id, r.services, r.reason, r.wait, r.ttl)),
    )
    rospy.Service("~release", ReleaseServices, lambda r: ReleaseServicesResponse(*bridge.release(caller(r), r.id)[:2]))
    rospy.Service(
        "~restart", RestartService, lambda r: RestartServiceResponse(*bridge.restart(caller(r), r.name, r.force)[:2])
    )
    rospy.Service(
        "~get_manifest", GetManifest, lambda r: GetManifestResponse(*bridge.get_manifest(caller(r), r.kind, r.name))
    )
    rospy.Service(
        "~put_manifest",
        PutManifest,
        lambda r: PutManifestResponse(*bridge.put_manifest(caller(r), r.kind, r.name, r.text, r.base, r.message)),
    )
    rospy.Service(
        "~remove_manifest",
        RemoveManifest,
        lambda r: RemoveManifestResponse(*bridge.remove_manifest(caller(r), r.kind, r.name, r.base, r.message)[:2]),
    )


def main() -> None:
    rospy.init_node("rorg")
    bridge = Bridge(Client(), Master(), others=rospy.get_param("~others", ""))
    offer(bridge)
    threading.Thread(target=publish, args=(Client(),), daemon=True).start()
    while not rospy.is_shutdown():
        try:
            for name in bridge.sweep():
                rospy.loginfo(f"{name} is gone; what it held is released")
        except Error as error:
            rospy.logwarn_throttle(10, str(error))
        rospy.rostime.wallsleep(0.5)


if __name__ == "__main__":
    main()
