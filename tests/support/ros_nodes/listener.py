"""Subscribes to std_msgs/String, provides a std_srvs/Empty, and publishes once: listener.py NAME TOPIC."""

import sys

import rospy
from std_msgs.msg import String
from std_srvs.srv import Empty, EmptyResponse

name, topic = sys.argv[1:]
rospy.init_node(name)
rospy.Subscriber(topic, String, lambda message: None)
rospy.Service(f"/{name}/clear", Empty, lambda request: EmptyResponse())
rospy.Publisher(f"/{name}/map", String, queue_size=1, latch=True).publish("map")
rospy.spin()
