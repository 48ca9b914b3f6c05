"""The wheels: obeys /cmd_vel, and reports odometry and joints 50 times a second, as a driver does."""

from math import cos, sin

import rospy
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

RATE = 50.0


class Base:
    def __init__(self):
        self.x, self.y, self.heading, self.wanted = 5.0, 2.0, 0.0, Twist()
        self.odometry = rospy.Publisher("/odom", Odometry, queue_size=5)
        self.joints = rospy.Publisher("/joint_states", JointState, queue_size=5)
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=5)
        rospy.Subscriber("/cmd_vel", Twist, self.obey, queue_size=1)
        rospy.Timer(rospy.Duration(1 / RATE), self.step)

    def obey(self, wanted):
        self.wanted = wanted

    def step(self, _):
        speed, turn = self.wanted.linear.x, self.wanted.angular.z
        self.heading += turn / RATE
        self.x += speed * cos(self.heading) / RATE
        self.y += speed * sin(self.heading) / RATE
        now = rospy.Time.now()
        said = Odometry(child_frame_id="base_link")
        said.header.stamp, said.header.frame_id = now, "odom"
        said.pose.pose.position.x, said.pose.pose.position.y = self.x, self.y
        said.pose.pose.orientation.z, said.pose.pose.orientation.w = sin(self.heading / 2), cos(self.heading / 2)
        said.twist.twist = self.wanted
        self.odometry.publish(said)
        moved = TransformStamped(header=said.header, child_frame_id="base_link")
        moved.transform.translation.x, moved.transform.translation.y = self.x, self.y
        moved.transform.rotation = said.pose.pose.orientation
        self.tf.publish(TFMessage([moved]))
        joints = JointState(name=["left_wheel", "right_wheel"], position=[self.x, self.y])
        joints.header.stamp = now
        self.joints.publish(joints)


rospy.init_node("base")
base = Base()
rospy.spin()
