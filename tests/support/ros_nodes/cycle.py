"""Plays actions through rorg's ROS services: cycle.py DIRECTORY NAME=SERVICE,SERVICE... (as programs/tour.py)."""

import pathlib
import sys

import rospy
from rorg_ros.srv import RequestServices

rospy.init_node("behaviour")
request = rospy.ServiceProxy("/rorg/request", RequestServices)
directory = pathlib.Path(sys.argv[1])
for word in sys.argv[2:]:
    name, _, services = word.partition("=")
    done = request("tour", services.split(","), name, 60.0, 0.0)
    if not done.success:
        sys.exit(done.message)
    (directory / f"ready-{name}").touch()
    while not (directory / f"next-{name}").exists() and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.02)
