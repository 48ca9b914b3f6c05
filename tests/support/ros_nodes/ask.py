"""Requests one service after another, says what came of it, and holds them: ask.py FILE NODE SERVICE..."""

import json
import os
import sys

import rospy
from rorg_ros.srv import RequestServices

file, node, *services = sys.argv[1:]
rospy.init_node(node)
request = rospy.ServiceProxy("/rorg/request", RequestServices)
request.wait_for_service(30)
told = []
for service in services:
    open(file + ".asks", "w").close()
    done = request(id=service, services=[service], wait=60.0)
    told.append([done.success, done.message])
with open(file + ".new", "w") as out:
    json.dump(told, out)
os.rename(file + ".new", file)
rospy.spin()
