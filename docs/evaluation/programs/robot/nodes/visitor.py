"""Uses the robot's programs as its behaviour and its visitors do: visitor.py standby|greet|tour. It is no part of the
robot, and is not measured."""

import itertools
import json
import socket
import sys
import urllib.request

import rospy
from geometry_msgs.msg import PoseStamped, Twist
from opencv_apps.msg import FaceArrayStamped, RectArrayStamped
from std_msgs.msg import Bool, String

GOALS = itertools.cycle(((5.0, 8.0), (8.5, 2.0), (1.2, 4.0)))
state, heard = sys.argv[1], {}
rospy.init_node(f"visitor_{state}")


def hear(topic, kind):
    heard[topic] = 0

    def count(_):
        heard[topic] += 1

    rospy.Subscriber(topic, kind, count)


def ask_database():
    with socket.create_connection(("localhost", 6379)) as redis:
        redis.sendall(b"SET visitor 1\r\nGET visitor\r\n")
        assert redis.recv(100).startswith(b"+OK")


def look_at_page():
    urllib.request.urlopen("http://localhost:8080").read()


say, talk, goal = (
    rospy.Publisher(topic, kind, queue_size=1, latch=True)
    for topic, kind in (("/say", String), ("/talk", Bool), ("/goal", PoseStamped))
)


def send_on():
    there = PoseStamped()
    there.pose.position.x, there.pose.position.y = next(GOALS)
    goal.publish(there)


def every(seconds, do):
    rospy.Timer(rospy.Duration(seconds), lambda _: do())


if state == "tour":
    hear("/people_detect/found", RectArrayStamped)
    hear("/cmd_vel", Twist)
    every(10, send_on)
    send_on()
else:
    hear("/face_detection/faces", FaceArrayStamped)
    every(0.2, ask_database)
if state == "greet":
    hear("/wakeword", String)
    hear("/recogniser", String)
    every(0.5, look_at_page)
talk.publish(state == "greet")
if state != "standby":
    every(4, lambda: say.publish("Welcome. This is the library, which is open every day but Sunday."))
rospy.on_shutdown(lambda: print(json.dumps(heard), flush=True))
rospy.spin()
