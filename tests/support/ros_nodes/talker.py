"""A ROS 1 node that publishes std_msgs/String: talker.py NAME."""

import sys

import rospy
from std_msgs.msg import String

rospy.init_node(sys.argv[1])
publisher = rospy.Publisher(f"/{sys.argv[1]}/chatter", String, queue_size=10)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    publisher.publish("hello")
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
