#!/usr/bin/env python3
"""The ROS 1 node /rorg: services request, release, query and restart, and the latched topic status."""

import threading
import xmlrpc.client

import rosgraph
import rospy
from rorg_ros.bridge import Bridge
from rorg_ros.msg import ServiceStatus, Status
from rorg_ros.srv import (
    QueryService,
    QueryServiceResponse,
    ReleaseServices,
    ReleaseServicesResponse,
    RequestServices,
    RequestServicesResponse,
    RestartService,
    RestartServiceResponse,
)

from rorg.client import Client, Error
from rorg.host.ros import listens


def caller(request) -> str:
    return request._connection_header["callerid"]


def alive(name: str) -> bool:
    """Registered, and somebody listens at its port: a paused node does, a killed one does not."""
    try:
        return listens(rosgraph.Master("/rorg").lookupNode(name))
    except rosgraph.MasterError:
        return False
    except (OSError, xmlrpc.client.Error):
        return True  # no master: nothing can be concluded


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


def main() -> None:
    rospy.init_node("rorg")
    bridge = Bridge(Client(), alive)
    rospy.on_shutdown(bridge.close)
    rospy.Service("~request", RequestServices, lambda r: RequestServicesResponse(
        *bridge.request(caller(r), r.id, r.services, r.reason, r.wait)))
    rospy.Service("~release", ReleaseServices, lambda r: ReleaseServicesResponse(*bridge.release(caller(r), r.id)))
    rospy.Service("~restart", RestartService, lambda r: RestartServiceResponse(*bridge.restart(r.name, r.force)))

    def query(request):
        found, message, service = bridge.query(request.name)
        return QueryServiceResponse(found, message, status_of(service) if found else ServiceStatus())

    rospy.Service("~query", QueryService, query)
    threading.Thread(target=publish, args=(Client(),), daemon=True).start()
    while not rospy.is_shutdown():
        for name in bridge.sweep():
            rospy.loginfo(f"{name} is gone; what it held is released")
        rospy.rostime.wallsleep(0.5)


if __name__ == "__main__":
    main()
