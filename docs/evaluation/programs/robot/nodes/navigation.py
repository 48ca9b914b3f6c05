"""Plans once a second from where the robot is to /goal, and follows the path 10 times a second; without a goal it
waits. Debian does not ship move_base."""

from math import atan2, hypot, remainder, tau

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid

STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0))
COARSE = 4
"""Cells of the map, along each side, that it plans with as one."""
NEAR = 0.3
"""Metres."""


class Navigation:
    def __init__(self, grid):
        size = grid.info.width // COARSE
        cells = np.array(grid.data).reshape(size, COARSE, size, COARSE).max(axis=(1, 3)) > 0
        self.blocked, self.cell = cells, grid.info.resolution * COARSE
        self.goal = self.pose = None
        self.ticks, self.path = 0, []
        self.speeds = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        rospy.Subscriber("/goal", PoseStamped, lambda said: setattr(self, "goal", said.pose.position), queue_size=1)
        rospy.Subscriber("/pose", PoseStamped, lambda said: setattr(self, "pose", said.pose), queue_size=1)

    def place(self, point):
        return int(point.y / self.cell), int(point.x / self.cell)

    def plan(self):
        """The cells from here to the goal: a wave that begins at the goal and ends here."""
        start, goal = self.place(self.pose.position), self.place(self.goal)
        after, wave = {goal: goal}, [goal]
        for y, x in wave:
            for dy, dx in STEPS:
                to = y + dy, x + dx
                if to not in after and not self.blocked[to]:
                    after[to] = y, x
                    wave.append(to)
        self.path = [start]
        while self.path[-1] != goal and self.path[-1] in after:
            self.path.append(after[self.path[-1]])

    def follow(self):
        if self.goal is None or self.pose is None:
            return
        if self.ticks % 10 == 0:
            self.plan()
        self.ticks += 1
        here = self.pose.position
        y, x = self.path[min(2, len(self.path) - 1)]
        heading = 2 * atan2(self.pose.orientation.z, self.pose.orientation.w)
        turn = remainder(atan2((y + 0.5) * self.cell - here.y, (x + 0.5) * self.cell - here.x) - heading, tau)
        if self.ticks % 10 > 1 and len(self.path) > 3 and abs(turn) < 1:
            self.path = self.path[1:] if hypot(x * self.cell - here.x, y * self.cell - here.y) < NEAR else self.path
        speed = Twist()
        if hypot(self.goal.x - here.x, self.goal.y - here.y) < NEAR:
            self.goal = None
        else:
            speed.linear.x, speed.angular.z = 0.5 * (abs(turn) < 0.5), max(-1.5, min(1.5, 2 * turn))
        self.speeds.publish(speed)


rospy.init_node("navigation")
navigation, rate = Navigation(rospy.wait_for_message("/map", OccupancyGrid)), rospy.Rate(10)
while not rospy.is_shutdown():
    navigation.follow()
    rate.sleep()
