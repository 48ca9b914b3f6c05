"""Gives itself another node's name, and calls as that one: impostor.py FILE NODE ID SERVICE."""

import json
import os
import sys

import rospy
from rorg_ros.srv import ReleaseServices, RequestServices, RestartService

file, node, id, service = sys.argv[1:]
rospy.init_node("impostor")
rospy.names.get_caller_id = lambda: node
calls = {
    "release": (ReleaseServices, {"id": id}),
    "request": (RequestServices, {"id": id, "services": [service]}),
    "restart": (RestartService, {"name": service, "force": True}),
}
told = {}
for name, (kind, fields) in calls.items():
    call = rospy.ServiceProxy(f"/rorg/{name}", kind)
    call.wait_for_service(30)
    done = call(**fields)
    told[name] = [done.success, done.message]
with open(file + ".new", "w") as out:
    json.dump(told, out)
os.rename(file + ".new", file)
rospy.spin()
