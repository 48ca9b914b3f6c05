"""A ROS 1 behaviour that uses rorg's services, writes down what they said, and goes on: behaviour.py FILE."""

import json
import os
import sys

import rospy
from rorg_ros.msg import Status
from rorg_ros.srv import QueryService, RequestServices, RestartService

rospy.init_node("behaviour")
request = rospy.ServiceProxy("/rorg/request", RequestServices)
restart = rospy.ServiceProxy("/rorg/restart", RestartService)
request.wait_for_service(30)
told = {}
done = request("look", ["/camera"], "to see", 30.0, 0.0)
told["request"] = [done.success, done.message]
done = rospy.ServiceProxy("/rorg/query", QueryService)("/camera")
told["query"] = [done.success, done.status.name, done.status.health]
done = request("other", ["roscore"], "", 0.0, 0.0)
told["forbidden"] = [done.success, done.message]
done = restart("camera", False)
told["restart"] = [done.success, done.message]
done = restart("arm", False)
told["restart_arm"] = [done.success, done.message]
told["status"] = [s.name for s in rospy.wait_for_message("/rorg/status", Status, 10).services]
with open(sys.argv[1] + ".new", "w") as file:
    json.dump(told, file)
os.rename(sys.argv[1] + ".new", sys.argv[1])
rospy.spin()
