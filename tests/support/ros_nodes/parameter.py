"""A ROS 1 node that says what a parameter is when it begins: parameter.py NODE PARAMETER."""

import sys

import rospy

rospy.init_node(sys.argv[1])
print(rospy.get_param(sys.argv[2], "not set"), flush=True)
rospy.spin()
