"""A particle filter, as amcl is one: it computes when the robot has moved. Debian ships neither amcl nor a SLAM."""

from math import atan2, cos, hypot, sin

import cv2
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from room import ANGLES
from sensor_msgs.msg import LaserScan

PARTICLES = 500
STEP = 0.1
"""Metres or radians of movement before it computes again."""
SPREAD = 0.1
"""Metres of deviation of a range."""


class Filter:
    def __init__(self, grid, start):
        self.cell, size = grid.info.resolution, grid.info.width
        free = (np.array(grid.data, np.int8).reshape(size, size) == 0).astype(np.uint8)
        self.distance = cv2.distanceTransform(free, cv2.DIST_L2, 5) * self.cell
        self.random, self.odometry, self.before = np.random.default_rng(1), start, start
        self.particles = start + self.random.normal(0, (0.2, 0.2, 0.1), (PARTICLES, 3))
        self.poses = rospy.Publisher("/pose", PoseStamped, queue_size=2)

    def moved(self, said):
        self.odometry = planar(said)

    def scanned(self, said):
        ahead = self.odometry - self.before
        if hypot(*ahead[:2]) > STEP or abs(ahead[2]) > STEP:
            self.before = self.odometry
            self.update(ahead, np.array(said.ranges)[::6], ANGLES[::6])
        x, y, heading = self.particles.mean(axis=0)
        pose = PoseStamped(header=said.header)
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = sin(heading / 2), cos(heading / 2)
        self.poses.publish(pose)

    def update(self, ahead, ranges, angles):
        self.particles += ahead + self.random.normal(0, (0.03, 0.03, 0.02), (PARTICLES, 3))
        directions = self.particles[:, 2:] + angles
        hits = [self.particles[:, n : n + 1] + f(directions) * ranges for n, f in enumerate((np.cos, np.sin))]
        columns, rows = ((hit / self.cell).astype(int).clip(0, len(self.distance) - 1) for hit in hits)
        weights = -np.minimum(self.distance[rows, columns], 0.5).sum(axis=1) / SPREAD
        weights = np.exp(weights - weights.max())
        self.particles = self.particles[self.random.choice(PARTICLES, PARTICLES, p=weights / weights.sum())]


def planar(said):
    pose = said.pose.pose
    return np.array((pose.position.x, pose.position.y, 2 * atan2(pose.orientation.z, pose.orientation.w)))


rospy.init_node("localization")
found = Filter(rospy.wait_for_message("/map", OccupancyGrid), planar(rospy.wait_for_message("/odom", Odometry)))
rospy.Subscriber("/odom", Odometry, found.moved, queue_size=1)
rospy.Subscriber("/scan", LaserScan, found.scanned, queue_size=1)
rospy.spin()
