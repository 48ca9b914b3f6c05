"""Requests, checks and releases a service COUNT times, back to back, and holds it then: cycles.py FILE SERVICE COUNT.
The file tells what was found otherwise than told."""

import json
import os
import random
import sys

import rospy
from rorg_ros.srv import QueryService, ReleaseServices, RequestServices

rospy.init_node("cycles")
request = rospy.ServiceProxy("/rorg/request", RequestServices)
release = rospy.ServiceProxy("/rorg/release", ReleaseServices)
query = rospy.ServiceProxy("/rorg/query", QueryService)
request.wait_for_service(30)
file, service, *more = sys.argv[1:]
count = int(more[0]) if more else 30
wrong, pauses = [], random.Random(1)
for number in range(count + 1):
    done = request(id="cycle", services=[service], wait=30.0)
    found = query(service).status
    if not done.success or (found.state, found.health, found.wanted) != ("running", "Healthy", True):
        wrong.append([number, done.message, found.state, found.health, found.why])
    rospy.rostime.wallsleep(pauses.random() * 0.03)
    if number < count:
        release("cycle")
        rospy.rostime.wallsleep(pauses.random() * 0.03)
with open(file + ".new", "w") as out:
    json.dump(wrong, out)
os.rename(file + ".new", file)
rospy.spin()
