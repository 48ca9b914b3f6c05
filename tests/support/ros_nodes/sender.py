"""Publishes long std_msgs/String without a queue, so that a subscriber that does not read holds it up, and writes down
how many it has sent: sender.py NAME TOPIC FILE."""

import sys

import rospy
from std_msgs.msg import String

name, topic, file = sys.argv[1:]
rospy.init_node(name)
publisher = rospy.Publisher(topic, String, queue_size=None)
text, sent = String("x" * 200_000), 0
while not rospy.is_shutdown():
    publisher.publish(text)
    sent += 1
    with open(file, "w") as out:
        out.write(str(sent))
    try:
        rospy.sleep(0.02)
    except rospy.ROSInterruptException:
        break
