"""A microphone: 100 ms of 16-bit audio at 16 kHz, 10 times a second. It hears a quiet room, and a person while /talk is
true."""

import random
from pathlib import Path

import rospy
from std_msgs.msg import Bool, UInt8MultiArray

CHUNK = 3200
"""Bytes."""
rospy.init_node("microphone")
person = Path("/recordings/person.raw").read_bytes()
noise = b"".join(random.randint(-40, 40).to_bytes(2, "little", signed=True) for _ in range(len(person) // 2))
heard = noise


def talk(said):
    global heard
    heard = person if said.data else noise


rospy.Subscriber("/talk", Bool, talk, queue_size=1)
audio, rate, at = rospy.Publisher("/audio", UInt8MultiArray, queue_size=20), rospy.Rate(10), 0
while not rospy.is_shutdown():
    audio.publish(UInt8MultiArray(data=heard[at : at + CHUNK]))
    at = (at + CHUNK) % (len(heard) - CHUNK)
    rate.sleep()
