"""A laser: 360 beams, 10 times a second, in the room where the base says it is."""

from math import atan2

import rospy
from nav_msgs.msg import Odometry
from room import ANGLES, RANGE, room, scan
from sensor_msgs.msg import LaserScan

rospy.init_node("laser")
grid, scans = room(), rospy.Publisher("/scan", LaserScan, queue_size=2)
pose = rospy.wait_for_message("/odom", Odometry).pose.pose


def moved(said):
    global pose
    pose = said.pose.pose


rospy.Subscriber("/odom", Odometry, moved, queue_size=1)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    said = LaserScan(angle_min=ANGLES[0], angle_max=ANGLES[-1], angle_increment=ANGLES[1] - ANGLES[0], range_max=RANGE)
    said.header.stamp, said.header.frame_id = rospy.Time.now(), "base_link"
    heading = 2 * atan2(pose.orientation.z, pose.orientation.w)
    said.ranges = scan(grid, pose.position.x, pose.position.y, heading).tolist()
    scans.publish(said)
    rate.sleep()
